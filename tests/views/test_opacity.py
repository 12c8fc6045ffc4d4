"""An object that is see-through by its picture's own alpha is as whole as an opaque one."""

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.structures import UvMesh
from arm_blender.views import load_views
from arm_blender.views.image_io import write_png
from arm_blender.views.mask_files import with_mask
from arm_blender.views.opacity import solid

from ..colored_box import BODY, COLORS, cameras, side_errors, split_box, write_views
from ..colored_box import picture as box_picture
from ..pictures import picture


def ball(softness: float = 1.0) -> torch.Tensor:
    """(128, 128) alpha of a disc of radius 40, its outline `softness` pixels wide."""
    row, column = torch.meshgrid(torch.arange(128.0), torch.arange(128.0), indexing="ij")
    distance = ((row - 63.5) ** 2 + (column - 63.5) ** 2).sqrt()
    return ((40.0 - distance) / softness + 0.5).clamp(0.0, 1.0)


@pytest.mark.parametrize("softness", [0.01, 1.0, 3.0])
def test_an_opaque_object_keeps_its_alpha_to_the_last_digit(softness):
    alpha = ball(softness)
    assert solid(alpha) is alpha
    assert solid(torch.zeros(9, 9)).sum() == 0.0


@pytest.mark.parametrize("share", [0.85, 0.8, 0.5, 0.3, 0.1])
def test_a_see_through_object_has_the_outline_of_an_opaque_one(share):
    torch.testing.assert_close(solid(ball() * share), ball(), atol=0.01, rtol=0.0)


def test_glass_with_an_opaque_label_is_whole():
    alpha = ball() * 0.35
    alpha[54:74, 50:78] = 1.0
    found = solid(alpha)
    assert torch.equal(found > 0.5, ball() > 0.5)
    assert float((found[ball() == 1.0] >= 0.9).float().mean()) > 0.9


def test_glass_of_uneven_alpha_has_no_holes():
    noise = torch.rand(128, 128, generator=torch.Generator().manual_seed(0))
    alpha = ball() * (0.3 + 0.3 * noise)
    found = solid(alpha)
    assert float((found[ball() == 1.0] > 0.5).float().mean()) > 0.99
    assert float((found[ball() == 1.0] >= 0.9).float().mean()) > 0.6


def test_the_soft_shadow_of_an_opaque_object_is_no_part_of_it():
    alpha = ball()
    alpha[110:120] = 0.4
    assert torch.equal(solid(alpha), alpha)


def test_a_see_through_view_is_read_opaque_and_its_report_says_so(tmp_path):
    image = picture()
    image[3] *= 0.4
    write_png(tmp_path / "glass.png", image, srgb=True)
    heard = []
    views = load_views(tmp_path / "glass.png", heard=lambda *words: heard.append(words))
    assert float(views.images[0, 3].max()) == 1.0
    assert heard == [
        ("glass.png", "alpha"),
        ("glass.png", "doubtful: the object is see-through, and the asset will be opaque"),
    ]


def test_a_wide_soft_outline_stays_where_it_is():
    found = solid(ball(30.0))
    assert torch.equal(found > 0.5, ball(30.0) > 0.5)
    outer = (ball(30.0) > 0.5) & (ball(30.0) < 0.6)
    assert float(found[outer].max()) < 0.9, "its mixed colours would count"


@pytest.mark.parametrize("level", [1, 2, 60, 200])
def test_a_mask_of_labels_or_in_grey_cuts_out_what_it_marks(tmp_path, level):
    mask = np.zeros((20, 30), np.uint8)
    mask[4:16, 5:25] = level
    Image.fromarray(mask).save(tmp_path / "mask.png")
    cut = with_mask(torch.ones(4, 20, 30), tmp_path / "mask.png")
    torch.testing.assert_close(cut[3], torch.from_numpy((mask > 0).astype(np.float32)))


@pytest.mark.parametrize("share", [0.8, 0.3])
def test_every_side_of_a_see_through_box_has_its_colour(tmp_path, share):
    (vertices, uvs, faces) = split_box(*BODY)
    mesh = UvMesh(*map(torch.from_numpy, (vertices, faces, uvs, faces)), 6)
    images = [box_picture(camera) for camera in cameras()]
    for image in images:
        image[3] *= share
    errors, seen = side_errors(mesh, load_views(write_views(tmp_path / "box", images)))
    assert set(errors) == set(COLORS) and max(errors.values()) < 3 / 255 and seen > 0.7
