"""Crops, sizes, and views that see nothing."""

from pathlib import Path

import pytest
import torch

from arm_blender.errors import InputImageError
from arm_blender.views import preprocess

PATH = Path("mug.png")


def disc(size: int, radius: float, row: float, column: float) -> torch.Tensor:
    rows, columns = torch.meshgrid(torch.arange(size) + 0.5, torch.arange(size) + 0.5, indexing="ij")
    return (rows - row) ** 2 + (columns - column) ** 2 < radius**2


@pytest.mark.parametrize("center", [(40.0, 50.0), (5.0, 90.0)])
def test_the_crop_centres_the_object_at_its_ratio(center):
    """Also where the object touches the border: the window reaches beyond the picture."""
    mask = disc(96, 20.0, *center)
    image = torch.cat([torch.rand(3, 96, 96), mask[None].float()])
    window, longest, known = preprocess.crop_single(image, PATH)
    rows, columns = torch.nonzero(window[3] > 0.5, as_tuple=True)
    assert window.shape[1] == window.shape[2]
    assert longest == max(int(rows.max() - rows.min()), int(columns.max() - columns.min())) + 1
    assert longest / window.shape[1] == pytest.approx(preprocess.FOREGROUND_RATIO, abs=0.02)
    for places in (rows, columns):
        assert float(places.min() + places.max() + 1) / 2.0 == pytest.approx(window.shape[1] / 2.0, abs=0.5)
    # Nothing of the object is lost and nothing is made up.
    assert torch.equal(window[:3, window[3] > 0.5].sort(dim=1).values, image[:3, mask].sort(dim=1).values)


def test_an_empty_picture_cannot_be_cropped():
    with pytest.raises(InputImageError, match="mug.png: the mask is empty"):
        preprocess.crop_single(torch.zeros(4, 64, 64), PATH)


def test_views_that_see_nothing_do_not_take_part():
    full, empty = torch.ones(4, 64, 64), torch.zeros(4, 64, 64)
    assert preprocess.seeing_views([empty, full, empty, full], [PATH] * 4) == [1, 3]
    with pytest.raises(InputImageError, match="mug.png: the mask is empty in every view"):
        preprocess.seeing_views([empty, empty], [PATH] * 2)


def test_scaling_down_keeps_the_objects_colour_and_area():
    """The background is magenta under alpha 0: none of it may show at the edges."""
    size = preprocess.MAXIMUM_SIDE * 2
    image = torch.zeros(4, size, 64)
    image[:3] = torch.tensor([1.0, 0.0, 1.0])[:, None, None]
    image[:, size // 3 :, 21:] = torch.tensor([0.2, 0.4, 0.6, 1.0])[:, None, None]
    small = preprocess.limit_size(image, PATH)
    assert small.shape == (4, preprocess.MAXIMUM_SIDE, 32)
    color = small[:3, small[3] > 0.0]
    torch.testing.assert_close(color, torch.tensor([0.2, 0.4, 0.6])[:, None].expand_as(color))
    assert float(small[3].mean()) == pytest.approx(float(image[3].mean()), rel=1e-5)


def test_sizes_that_do_not_do_are_named():
    with pytest.raises(InputImageError, match="mug.png: 64x8 pixels"):
        preprocess.limit_size(torch.zeros(4, 8, 64), PATH)
    with pytest.raises(InputImageError, match="b.png.*64x32 and 64x64"):
        preprocess.same_size([torch.zeros(4, 64, 64), torch.zeros(4, 32, 64)], [Path("a.png"), Path("b.png")])
