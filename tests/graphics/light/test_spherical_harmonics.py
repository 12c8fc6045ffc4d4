"""Harmonics are orthonormal, and gather what an integral over the sphere gathers."""

import math

import pytest
import torch
from torch.nn import functional

from arm_blender.graphics.light.environment import Environment
from arm_blender.graphics.light.spherical_harmonics import COUNT, gathered, harmonics


@pytest.fixture
def texels():
    """An environment that is 1 everywhere, as lights: a fine quadrature of the sphere."""
    return Environment(torch.ones(3, 64, 128)).texels()


def test_they_are_orthonormal(texels):
    values = harmonics(texels.direction)
    square = (values * texels.power[:, :1]).T @ values
    torch.testing.assert_close(square, torch.eye(COUNT), atol=2e-3, rtol=0.0)


def test_white_light_from_everywhere_leaves_white_matte_things_white(texels):
    light = harmonics(texels.direction).T @ texels.power
    normals = functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    torch.testing.assert_close(gathered(normals) @ light, torch.ones(50, 3), atol=2e-3, rtol=0.0)


def test_smooth_light_is_gathered_as_by_the_integral(texels):
    """Radiance of order 2: (1 + d . a)^2 for a slanted axis a."""
    axis = torch.tensor([0.6, 0.0, 0.8])
    power = texels.power * (1.0 + texels.direction @ axis).square()[:, None]
    normals = functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    integral = (normals @ texels.direction.T).clamp(min=0.0) @ power / math.pi
    light = harmonics(texels.direction).T @ power
    torch.testing.assert_close(gathered(normals) @ light, integral, atol=5e-3, rtol=0.0)
