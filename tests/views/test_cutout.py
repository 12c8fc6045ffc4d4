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
    monkeypatch.setattr(cutout, "load_cutout", lambda path, changed: Redness())


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
    found = cutout.along_edges(srgb, coarse)
    assert iou(enlarged, mask) < 0.97 < 0.98 < iou(found, mask)


def on_a_table(height: int, width: int, radius: float, row: float, column: float) -> tuple[torch.Tensor, torch.Tensor]:
    """A shaded clay ball on a table before a wall, with a soft shadow: (4, H, W) linear, and its mask (H, W)."""
    random = torch.Generator().manual_seed(0)
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    grain = interpolate(torch.rand(1, 1, height // 4, width // 16, generator=random), (height, width), mode="bicubic")
    table = (0.25 + 0.3 * grain[0]) * torch.tensor([0.8, 0.6, 0.4])[:, None, None]
    wall = (0.5 + 0.1 * columns / width) * torch.tensor([0.7, 0.8, 0.9])[:, None, None]
    picture = torch.where(rows < 0.3 * height, wall, table)
    away = ((rows - row - radius) / 0.25).square() + (columns - column - 0.4 * radius).square()
    picture = picture * (1.0 - 0.6 * (-away / (0.8 * radius) ** 2).exp())
    x, y = (columns - column) / radius, (rows - row) / radius
    z = (1.0 - x * x - y * y).clamp(min=0.0).sqrt()
    light = 0.25 + 0.75 * (0.6 * z - 0.6 * y - 0.4 * x).clamp(min=0.0)
    mask = x * x + y * y < 1.0
    picture = torch.where(mask, light * torch.tensor([0.85, 0.25, 0.15])[:, None, None], picture)
    srgb = picture + 0.02 * torch.randn(picture.shape, generator=random)
    return torch.cat([linear_from_srgb(srgb), torch.ones(1, height, width)]), mask


@pytest.mark.parametrize(
    ("size", "radius", "row", "column"),
    [((480, 640), 120.0, 260.0, 330.0), ((640, 480), 70.0, 400.0, 200.0), ((300, 300), 100.0, 170.0, 150.0)],
)
def test_what_ships_finds_a_ball_on_a_table(size, radius, row, column):
    picture, mask = on_a_table(*size, radius, row, column)
    alpha = cut_out(picture)
    assert iou(alpha, mask) > 0.93
    assert torch.equal(alpha, cut_out(picture))


def test_what_ships_is_sure_of_nothing_in_noise_and_in_grey():
    noise = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))
    for picture in (noise, torch.full((3, 200, 300), 0.4)):
        with pytest.raises(Unsure):
            cut_out(torch.cat([picture, torch.ones_like(picture[:1])]))
