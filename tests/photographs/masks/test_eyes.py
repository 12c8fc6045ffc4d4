"""Lenses as they were solved: what is seen where, and back along the ray."""

import pytest
import torch

from arm_blender.graphics.cameras import look_at
from arm_blender.photographs.capture import Lens
from arm_blender.photographs.masks.eyes import Eye

PINHOLE = Lens("SIMPLE_PINHOLE", (300.0, 158.0, 123.0), 320, 240)
BENT = Lens("SIMPLE_RADIAL", (300.0, 158.0, 123.0, 0.08), 320, 240)


def eye(lens: Lens) -> Eye:
    c2w = look_at(torch.tensor([1.0, -3.0, 1.5]), torch.tensor([0.1, 0.0, 0.2])).double()
    return Eye(torch.linalg.inv(c2w @ torch.diag(c2w.new_tensor([1.0, -1.0, -1.0, 1.0]))), lens)


@pytest.mark.parametrize("lens", [PINHOLE, BENT])
def test_places_follow_the_formula_of_the_lens(lens):
    own = eye(lens)
    points = torch.rand(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 2.0 - 1.0
    local = points @ own.w2c[:3, :3].T + own.w2c[:3, 3]
    u, v = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
    bend = 1.0 + (lens.parameters[3] if len(lens.parameters) > 3 else 0.0) * (u * u + v * v)
    x, y = 300.0 * u * bend + 158.0, 300.0 * v * bend + 123.0
    place, inside = own.places(points)
    torch.testing.assert_close((place + 1.0) / 2.0 * torch.tensor([320.0, 240.0]).double(), torch.stack([x, y], dim=1))
    assert torch.equal(inside, (x > 0) & (x < 320) & (y > 0) & (y < 240)) and bool(inside.any())


@pytest.mark.parametrize("lens", [PINHOLE, BENT])
def test_a_ray_goes_back_to_the_point(lens):
    own = eye(lens)
    points = torch.rand(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2)) * 1.6 - 0.8
    rays = own.rays(own.places(points)[0])
    expected = torch.nn.functional.normalize(points - own.center, dim=1)
    torch.testing.assert_close(rays, expected, rtol=0.0, atol=1e-6)


def test_what_is_behind_is_not_seen():
    own = eye(PINHOLE)
    behind = own.center * 2.0
    assert not bool(own.places(behind[None])[1][0])


def test_a_lens_that_bends_back_shows_nothing_from_beyond():
    own = eye(Lens("SIMPLE_RADIAL", (300.0, 158.0, 123.0, -0.3), 320, 240))
    aside = own.center + own.w2c[2, :3] + 1.8 * own.w2c[0, :3]  # r = 1.8; its image would be in the picture again.
    place, inside = own.places(aside[None])
    assert bool((place.abs() < 1.0).all()) and not bool(inside[0])
