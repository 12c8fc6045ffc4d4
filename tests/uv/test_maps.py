"""Padding, filling and constant maps; the nearest texel by SciPy's exact distance transform."""

import pytest
import torch
from scipy.ndimage import distance_transform_edt

from arm_blender.structures import TexelMap
from arm_blender.uv.maps import constant_value, diffuse_fill, pad


def blobs(size: int, count: int, seed: int) -> torch.Tensor:
    """(size, size) bool: a few rectangles."""
    generator = torch.Generator().manual_seed(seed)
    mask = torch.zeros(size, size, dtype=torch.bool)
    for y, x, height, width in torch.randint(1, size, (count, 4), generator=generator).tolist():
        mask[y : y + 1 + height // 6, x : x + 1 + width // 6] = True
    return mask


def plane_texels(size: int, mask: torch.Tensor) -> TexelMap:
    """An atlas that shows the square [-1, 1]^2 at z = 0 as it is."""
    axis = (torch.arange(size) + 0.5) / size * 2 - 1
    y, x = torch.meshgrid(-axis, axis, indexing="ij")
    position = torch.stack([x, y, torch.zeros(size, size)]) * mask
    normal = torch.tensor([0.0, 0.0, 1.0])[:, None, None] * mask
    return TexelMap(position, normal, mask)


@pytest.mark.parametrize(("size", "count"), [(97, 6), (128, 40), (64, 1)])
def test_padding_takes_the_nearest_covered_texel(size: int, count: int) -> None:
    mask = blobs(size, count, seed=count)
    y, x = torch.meshgrid(torch.arange(size), torch.arange(size), indexing="ij")
    padded = pad(torch.stack([y, x]).float(), mask)  # Every texel then names the texel that it took its value from.
    distance = ((padded[0] - y) ** 2 + (padded[1] - x) ** 2).sqrt()
    torch.testing.assert_close(distance, torch.tensor(distance_transform_edt(~mask.numpy())).float())
    assert mask[padded[0].long(), padded[1].long()].all()


def test_padding_never_changes_covered_texels() -> None:
    mask = blobs(80, 12, seed=5)
    image = torch.rand(3, 80, 80, generator=torch.Generator().manual_seed(0))
    assert torch.equal(pad(image, mask)[:, mask], image[:, mask])
    full = torch.ones_like(mask)
    assert torch.equal(pad(image, full), image) and torch.equal(pad(image, ~full), image)
    with pytest.raises(ValueError, match="expected"):
        pad(image, mask[1:])


def test_charts_with_a_gap_do_not_bleed_into_each_other() -> None:
    mask = torch.zeros(32, 32, dtype=torch.bool)
    mask[:, :12], mask[:, 20:] = True, True  # A gap of 8 texels: a filter that reaches 4 texels is safe.
    image = torch.where(torch.arange(32) < 16, 0.25, 0.75).expand(1, 32, 32).clone()
    image[0, :, 12:20] = 9.0
    padded = pad(image, mask)
    assert torch.equal(padded[0, :, :16], torch.full((32, 16), 0.25))
    assert torch.equal(padded[0, :, 16:], torch.full((32, 16), 0.75))


def test_fill_leaves_known_texels_and_keeps_a_constant() -> None:
    mask = blobs(64, 14, seed=2)
    texels = plane_texels(64, mask)
    known = mask & (torch.rand(64, 64, generator=torch.Generator().manual_seed(1)) < 0.3)
    color = torch.tensor([0.2, 0.5, 0.7])[:, None, None].expand(3, 64, 64).clone()
    color[:, ~known] = torch.nan  # What is not known must not be read.
    filled = diffuse_fill(color.nan_to_num(9.0), known, texels)
    assert torch.equal(filled[:, known], color[:, known])
    torch.testing.assert_close(
        filled[:, mask], torch.tensor([0.2, 0.5, 0.7])[:, None].expand(3, int(mask.sum())), atol=1e-5, rtol=0
    )
    assert torch.equal(filled[:, ~mask], torch.zeros(3, int((~mask).sum())))


def test_fill_stays_between_the_known_colours_and_follows_what_is_near() -> None:
    texels = plane_texels(96, torch.ones(96, 96, dtype=torch.bool))
    x = texels.position[0]
    known = x.abs() > 0.4
    color = torch.where(x < 0, 0.1, 0.9)[None]
    filled = diffuse_fill(color, known, texels)
    assert float(filled.min()) >= 0.1 - 1e-5 and float(filled.max()) <= 0.9 + 1e-5
    assert float(filled[0][(x < -0.3) & ~known].mean()) < 0.25
    assert float(filled[0][(x > 0.3) & ~known].mean()) > 0.75
    assert float(filled[0][x.abs() < 0.05].mean()) == pytest.approx(0.5, abs=0.05)


def test_fill_crosses_charts_in_space_not_in_the_atlas() -> None:
    # Two charts show the same square; beside them in the atlas lies a third that shows a far one of another colour.
    size = 48
    mask = torch.zeros(size, size, dtype=torch.bool)
    mask[:, :14], mask[:, 16:30], mask[:, 32:46] = True, True, True
    local = torch.stack(torch.meshgrid(torch.linspace(0, 1, size), torch.linspace(0, 0.3, 14), indexing="ij"))
    position = torch.zeros(3, size, size)
    position[:2, :, :14], position[:2, :, 16:30], position[:2, :, 32:46] = local, local + 3.0, local
    color = torch.zeros(1, size, size)
    color[:, :, :14], color[:, :, 16:30] = 0.8, 0.2
    known = mask.clone()
    known[:, 32:46] = False
    filled = diffuse_fill(color, known, TexelMap(position, torch.zeros(3, size, size), mask))
    torch.testing.assert_close(filled[0, :, 32:46], torch.full((size, 14), 0.8), atol=0.02, rtol=0)


def test_fill_without_any_known_texel_is_grey() -> None:
    mask = blobs(16, 3, seed=0)
    filled = diffuse_fill(torch.rand(3, 16, 16), torch.zeros_like(mask), plane_texels(16, mask))
    assert torch.equal(filled, 0.5 * mask.expand(3, 16, 16))


def test_constant_maps_are_found_within_the_tolerance() -> None:
    mask = torch.zeros(8, 8, dtype=torch.bool)
    mask[2:5] = True
    image = torch.rand(1, 8, 8)
    image[0, mask] = torch.linspace(0.48, 0.52, int(mask.sum()))
    assert constant_value(image, mask, 0.021) == pytest.approx(0.5)
    assert constant_value(image, mask, 0.019) is None
    assert constant_value(image, torch.ones_like(mask), 0.021) is None
    assert constant_value(torch.full((1, 4, 4), 0.25), torch.ones(4, 4, dtype=torch.bool), 0.0) == 0.25
    assert constant_value(image, torch.zeros_like(mask), 1.0) is None
    assert constant_value(torch.full((1, 4, 4), torch.nan), torch.ones(4, 4, dtype=torch.bool), 1.0) is None
