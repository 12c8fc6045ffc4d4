"""Reading views at texels against closed forms."""

import pytest
import torch

from arm_blender.uv.view_sampling import footprint, sample_view


def ramp(height: int, width: int) -> torch.Tensor:
    """(4, H, W): red is x, green is y, in pixels at the centres; opaque."""
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    return torch.stack([x, y, torch.zeros_like(x), torch.ones_like(x)])


def test_a_linear_image_is_read_exactly_at_every_mip_level() -> None:
    generator = torch.Generator().manual_seed(0)
    pixels = 24.0 + 16.0 * torch.rand(50, 2, generator=generator)
    for step in (0.2, 1.0, 2.0, 3.1, 4.0):
        colors, found = sample_view(ramp(64, 64), pixels, torch.full((50,), step), 0.9)
        assert found.all()
        torch.testing.assert_close(colors[:2].T, pixels, atol=1e-3, rtol=0)


def test_nothing_beside_the_opaque_pixels_is_read() -> None:
    image = ramp(32, 32)
    image[:3] = 0.25
    image[:3, :, 16:], image[3, :, 16:] = torch.nan, 0.0
    pixels = torch.tensor([[8.0, 8.0], [15.9, 8.0], [16.1, 8.0], [24.0, 8.0]])
    for step in (1.0, 6.0):
        colors, found = sample_view(image, pixels, torch.full((4,), step), 0.9)
        assert found.tolist() == [True, True, False, False]
        torch.testing.assert_close(colors[:, found], torch.full((3, 2), 0.25))


def test_footprint_is_the_longer_step_and_does_not_cross_gaps() -> None:
    row, column = torch.meshgrid(torch.arange(8.0), torch.arange(8.0), indexing="ij")
    pixels = torch.stack([0.5 * column, 3.0 * row], dim=-1)
    pixels[:, 4:] += 100.0  # Another chart, which touches the first.
    mask = torch.ones(8, 8, dtype=torch.bool)
    torch.testing.assert_close(footprint(pixels, mask), torch.full((8, 8), 3.0))
    torch.testing.assert_close(footprint(pixels.transpose(0, 1).contiguous(), mask), torch.full((8, 8), 3.0))
    lone = torch.zeros(8, 8, dtype=torch.bool)
    lone[3, 3] = True
    assert float(footprint(pixels, lone)[3, 3]) == pytest.approx(1.0)
