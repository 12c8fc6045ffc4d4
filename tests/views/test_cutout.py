"""The small network as a way to cut out: windows, edges, sizes; and what ships knows an object when it sees one."""

import pytest
import torch
from torch.nn.functional import avg_pool2d, interpolate

from arm_blender.errors import CheckpointError
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.models.small.cutout import Cutout, CutoutConfig
from arm_blender.views import cutout
from arm_blender.views.cutout import cut_out
from arm_blender.views.masks import Unsure
from arm_blender.weight_files import checkpoints

TINY = CutoutConfig(widths=(4, 8, 8, 16), heads=2, attention_layers=1, side=64, closer_side=64)


class Redness(torch.nn.Module):
    """In the network's place: what is red is the object."""

    config = TINY

    def forward(self, srgb: torch.Tensor) -> torch.Tensor:
        return 40.0 * (srgb[:, :1] - srgb[:, 1:2] - 0.4)


def disc(height: int, width: int, radius: float, row: float, column: float) -> torch.Tensor:
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    return ((rows - row) ** 2 + (columns - column) ** 2).sqrt() < radius


def red_on_grey(mask: torch.Tensor) -> torch.Tensor:
    """(4, H, W) linear: a red thing before a grain of greys."""
    grey = 0.3 + 0.3 * torch.rand(1, *mask.shape, generator=torch.Generator().manual_seed(0))
    red = torch.tensor([0.9, 0.1, 0.1])[:, None, None]
    return torch.cat([linear_from_srgb(torch.where(mask, red, grey)), torch.ones(1, *mask.shape)])


def iou(alpha: torch.Tensor, mask: torch.Tensor) -> float:
    return float(((alpha > 0.5) & mask).sum() / ((alpha > 0.5) | mask).sum())


@pytest.fixture
def redness(monkeypatch, weights_folder) -> None:
    checkpoints.shipped("small.cutout").write_bytes(b"")
    monkeypatch.setattr(cutout, "_network", lambda path, changed: Redness())


@pytest.mark.parametrize(
    ("size", "radius", "row", "column"),
    [((300, 400), 90.0, 150.0, 200.0), ((400, 300), 20.0, 330.0, 50.0), ((700, 500), 240.0, 350.0, 260.0)],
)
def test_a_mask_of_64_pixels_reaches_the_edges_of_the_picture(redness, size, radius, row, column):
    mask = disc(*size, radius, row, column)
    alpha = cut_out(red_on_grey(mask))
    assert alpha.shape == size and alpha.dtype == torch.float32
    assert 0.0 <= float(alpha.min()) and float(alpha.max()) <= 1.0
    assert iou(alpha, mask) > 0.97


def test_what_the_border_cuts_is_cut_out_as_well(redness):
    mask = disc(300, 400, 120.0, 280.0, 380.0)
    assert iou(cut_out(red_on_grey(mask)), mask) > 0.97


def test_without_an_object_or_without_weights_it_is_unsure(redness, weights_folder):
    with pytest.raises(Unsure, match="sees no object"):
        cut_out(red_on_grey(torch.zeros(200, 200, dtype=torch.bool)))
    checkpoints.shipped("small.cutout").unlink()
    with pytest.raises(Unsure, match="not installed"):
        cut_out(red_on_grey(disc(200, 200, 50.0, 100.0, 100.0)))


def test_weights_are_read_from_the_file_and_a_damaged_one_is_named(weights_folder):
    torch.manual_seed(0)
    path = checkpoints.shipped("small.cutout")
    network = Cutout(TINY)
    torch.nn.init.zeros_(network.out.weight)
    torch.nn.init.constant_(network.out.bias, -9.0)
    checkpoints.save(path, network.state_dict(), TINY, "cutout", half=True)
    with pytest.raises(Unsure):
        cut_out(red_on_grey(disc(100, 100, 30.0, 50.0, 50.0)))
    path.write_bytes(b"nothing")
    with pytest.raises(CheckpointError, match=r"small\.cutout"):
        cut_out(red_on_grey(disc(100, 100, 30.0, 50.0, 50.0)))


def test_the_filter_takes_a_coarse_mask_to_the_colours_edge():
    """A disc known at a quarter of the resolution, with soft edges: the filter finds the disc, enlarging does not."""
    mask = disc(512, 512, 150.0, 256.0, 250.0)
    coarse = avg_pool2d(mask[None, None].float(), 4)[0, 0]
    # Off by one coarse pixel, as networks are.
    coarse = coarse.roll(1, dims=1)
    srgb = torch.where(mask, torch.tensor([0.7, 0.5, 0.2])[:, None, None], torch.tensor([0.3, 0.4, 0.5])[:, None, None])
    enlarged = interpolate(coarse[None, None], (512, 512), mode="bilinear")[0, 0]
    found = cutout._along_edges(srgb, coarse)
    assert iou(enlarged, mask) < 0.97 < 0.98 < iou(found, mask)
