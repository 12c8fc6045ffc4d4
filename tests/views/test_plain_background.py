"""A plain background is cut away to the pixel, and where it is not plain enough nothing is made up."""

import pytest
import torch
from torch.nn.functional import avg_pool2d, max_pool2d

from arm_blender.graphics.color import linear_from_srgb
from arm_blender.views.masks import Unsure, flooded, sees_something, without_specks
from arm_blender.views.plain_background import _largest_near, plain_foreground

ORANGE = (0.9, 0.5, 0.1)


def disc(size: int, radius: float, row: float, column: float) -> torch.Tensor:
    rows, columns = torch.meshgrid(torch.arange(size) + 0.5, torch.arange(size) + 0.5, indexing="ij")
    return (rows - row) ** 2 + (columns - column) ** 2 < radius**2


def photograph(mask: torch.Tensor, background: float = 1.0, noise: float = 0.0, colour=ORANGE) -> torch.Tensor:
    """A plain object on a plain ground: without alpha, with a little noise. `mask` may have soft edges."""
    weight = mask.float()
    srgb = weight * torch.tensor(colour)[:, None, None] + (1.0 - weight) * background
    srgb = srgb + noise * (torch.rand(srgb.shape, generator=torch.Generator().manual_seed(0)) - 0.5)
    return torch.cat([linear_from_srgb(srgb), torch.ones(1, *mask.shape)])


def blurred(image: torch.Tensor, radius: int) -> torch.Tensor:
    return avg_pool2d(image[None].float(), 2 * radius + 1, 1, radius, count_include_pad=False)[0]


@pytest.mark.parametrize("background", [1.0, 0.5, 0.0])
def test_a_plain_background_is_cut_away(background):
    mask = disc(96, 30.0, 40.0, 50.0)
    assert torch.equal(plain_foreground(photograph(mask, background, noise=0.03)) > 0.5, mask)


def test_a_spiral_of_background_is_cut_to_its_end():
    """The flood has to turn many corners: each ring is open on the side opposite to that of the ring around it."""
    mask = torch.zeros(64, 64, dtype=torch.bool)
    for ring in range(4, 28, 4):
        mask[ring, ring:-ring] = mask[-ring - 1, ring:-ring] = True
        mask[ring:-ring, ring] = mask[ring:-ring, -ring - 1] = True
        mask[31:33, ring if ring % 8 else -ring - 1] = False
    assert torch.equal(plain_foreground(photograph(mask)) > 0.5, mask)


def test_the_backgrounds_colour_inside_the_object_stays():
    mask = disc(64, 25.0, 32.0, 32.0)
    eye = disc(64, 5.0, 32.0, 32.0)
    assert torch.equal(plain_foreground(photograph(mask & ~eye)) > 0.5, mask)


def test_dust_on_the_ground_is_no_part_of_the_object():
    mask = disc(96, 25.0, 40.0, 40.0)
    assert torch.equal(plain_foreground(photograph(mask | disc(96, 1.5, 85.0, 85.0))) > 0.5, mask)


@pytest.mark.parametrize("background", [1.0, 0.0])
def test_a_smooth_edge_becomes_its_share(background):
    """Of one colour: each pixel of the edge holds as much of the object as its alpha says, but for the tolerance."""
    share = avg_pool2d(disc(512, 130.0, 250.0, 260.0)[None].float(), 4)[0]
    assert float((plain_foreground(photograph(share, background)) - share).abs().max()) <= 0.07


@pytest.mark.parametrize("size", [128, 1024])
def test_an_unsharp_edge_is_still_an_edge(size):
    mask = disc(size, size / 4, size / 2, size / 2)
    found = plain_foreground(photograph(blurred(mask[None], size // 64)[0])) > 0.5
    assert int((found & mask).sum()) > 0.85 * int((found | mask).sum())


def test_a_busy_background_is_not_plain():
    image = torch.cat([torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0)), torch.ones(1, 64, 64)])
    with pytest.raises(Unsure, match="more than one colour"):
        plain_foreground(image)


def test_a_background_that_gets_darker_is_not_plain():
    image = photograph(disc(96, 20.0, 48.0, 48.0))
    image[:3] *= torch.linspace(0.3, 1.0, 96)[:, None]
    with pytest.raises(Unsure, match="more than one colour"):
        plain_foreground(image)


def test_an_even_picture_shows_nothing():
    with pytest.raises(Unsure, match="nothing in it differs"):
        plain_foreground(photograph(torch.zeros(64, 64), noise=0.03))


def test_a_white_ball_before_white_is_not_guessed_at():
    """Its lit side is the colour of the ground, and a flood gets in there."""
    mask = disc(128, 40.0, 64.0, 64.0)
    shade = torch.linspace(1.2, 0.4, 128).clamp(max=1.0).expand(128, 128)
    image = torch.where(mask, shade, torch.tensor(1.0))
    with pytest.raises(Unsure, match="run into each other"):
        plain_foreground(torch.cat([linear_from_srgb(image).expand(3, -1, -1), torch.ones(1, 128, 128)]))


def test_a_soft_shadow_is_not_taken_for_a_part_of_the_object():
    mask = disc(160, 30.0, 70.0, 80.0)
    shadow = blurred(disc(160, 34.0, 100.0, 80.0)[None], 14)[0]
    image = photograph(mask)
    image[:3] = torch.where(mask, image[:3], image[:3] * (1.0 - 0.6 * shadow))
    with pytest.raises(Unsure, match="shadow"):
        plain_foreground(image)


def test_a_flood_reaches_what_a_path_reaches():
    """Against a flood of one pixel's step at a time."""
    passable = torch.rand(40, 60, generator=torch.Generator().manual_seed(1)) < 0.62
    seeds = torch.zeros_like(passable)
    seeds[20, 28:32] = seeds[0, :4] = True
    slow = seeds & passable
    for _ in range(40 * 60):
        step = slow.clone()
        step[1:] |= slow[:-1]
        step[:-1] |= slow[1:]
        step[:, 1:] |= slow[:, :-1]
        step[:, :-1] |= slow[:, 1:]
        slow = step & passable
    assert 10 < int(slow.sum()) < int(passable.sum())
    assert torch.equal(flooded(seeds, passable), slow)


def test_specks_go_and_parts_stay():
    """As an independent labelling finds the parts."""
    from skimage.measure import label

    noise = torch.rand(80, 80, generator=torch.Generator().manual_seed(2)) < 0.5
    mask = noise | disc(80, 25.0, 40.0, 40.0)
    labels = torch.from_numpy(label(mask.numpy(), connectivity=1))
    areas = labels.flatten().bincount()
    areas[0] = 0
    expected = (areas[labels] >= 0.01 * areas.max()) & mask
    assert 0 < int((mask & ~expected).sum())
    assert torch.equal(without_specks(mask), expected)
    assert not bool(without_specks(torch.zeros(8, 8, dtype=torch.bool)).any())


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (3, 2), (20, 31)], ids=str)
@pytest.mark.parametrize("reach", [1, 2, 5, 13])
def test_the_largest_near_is_that_of_a_pooling(shape, reach):
    values = torch.rand(shape, generator=torch.Generator().manual_seed(3))
    expected = max_pool2d(values[None], 2 * reach + 1, 1, reach)[0]
    assert torch.equal(_largest_near(values, reach), expected)


def test_a_speck_of_dust_is_no_object():
    alpha = torch.zeros(640, 640)
    alpha[3, 3:5] = 1.0
    assert not sees_something(alpha)
    assert sees_something(disc(640, 20.0, 320.0, 320.0).float())
