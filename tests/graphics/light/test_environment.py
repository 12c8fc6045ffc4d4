"""Distant light against closed forms: uniform skies, single bright texels, and quadrature."""

import math

import pytest
import torch
from torch import Tensor

from arm_blender.graphics.light.environment import Environment, Lights, shade

UP = torch.tensor([[0.0, 0.0, 1.0]])


def sky(height: int = 32, seed: int = 0) -> Tensor:
    """Noise with a sun ten thousand times brighter."""
    radiance = torch.rand(3, height, 2 * height, generator=torch.Generator().manual_seed(seed))
    radiance[:, height // 4, height // 3] = 1e4
    return radiance


def diffuse(lights: Lights) -> Tensor:
    """What a white matt upward surface sends up."""
    return shade(UP, UP, torch.ones(1, 3), torch.ones(1, 1), torch.zeros(1, 1), lights, form="cycles")[0]


@pytest.mark.parametrize(
    ("row", "column", "expected"),
    [(16, 32, (1.0, 0.0, 0.0)), (16, 16, (0.0, 1.0, 0.0)), (16, 48, (0.0, -1.0, 0.0)), (0, 5, (0.0, 0.0, 1.0))],
)
def test_the_picture_lies_around_the_scene_as_in_blender(row: int, column: int, expected) -> None:
    radiance = torch.zeros(3, 32, 64)
    radiance[:, max(row - 1, 0) : row + 1, column - 1 : column + 1] = 1.0
    if row == 0:
        radiance[:, 0] = 1.0
    lights = Environment(radiance).texels()
    mean = (lights.direction * lights.power[:, :1]).sum(0)
    torch.testing.assert_close(mean / mean.norm(), torch.tensor(expected), atol=1e-5, rtol=0.0)


def test_looking_up_finds_what_the_texels_say() -> None:
    environment = Environment(sky(), turn=0.7)
    lights = environment.texels()
    solid_angle = environment._solid_angle().repeat_interleave(64)[:, None]
    torch.testing.assert_close(environment.look_up(lights.direction) * solid_angle, lights.power, rtol=2e-2, atol=1e-3)


def test_a_turn_turns_all_light() -> None:
    radiance = torch.zeros(3, 16, 32)
    radiance[:, 7:9, 15:17] = 1.0
    lights = Environment(radiance, turn=math.pi / 2).texels()
    mean = (lights.direction * lights.power[:, :1]).sum(0)
    torch.testing.assert_close(mean / mean.norm(), torch.tensor([0.0, 1.0, 0.0]), atol=1e-5, rtol=0.0)


def test_the_sphere_has_four_pi_steradians() -> None:
    white = Environment(torch.ones(3, 8, 16))
    for lights in (white.texels(), white.sample(100)):
        assert float(lights.power.sum(0)[0]) == pytest.approx(4.0 * math.pi, rel=1e-5)


def test_a_white_matt_surface_under_a_white_sky_is_white() -> None:
    found = diffuse(Environment(torch.ones(3, 64, 128)).texels())
    torch.testing.assert_close(found, torch.ones(3), atol=6e-3, rtol=0.0)


def test_samples_agree_with_quadrature_on_the_mean_and_have_no_fireflies() -> None:
    environment = Environment(sky())
    exact = diffuse(environment.texels())
    draws = [environment.sample(256, seed) for seed in range(40)]
    found = torch.stack([diffuse(lights) for lights in draws])
    error = found.std(0) / math.sqrt(len(draws))
    assert bool(((found.mean(0) - exact).abs() < 4.0 * error + 1e-3 * exact).all())
    luminance = torch.tensor([0.2126, 0.7152, 0.0722])
    powers = torch.stack([lights.power @ luminance for lights in draws])
    # Every light is as bright as any other: none can be a firefly.
    torch.testing.assert_close(powers, powers.mean().expand_as(powers), rtol=1e-3, atol=0.0)
    # Drawn uniformly, the sun alone would make the estimate waver by more than its value.
    assert float((found.std(0) / exact).max()) < 0.1


def test_the_seed_fixes_the_samples() -> None:
    environment = Environment(sky())
    assert torch.equal(environment.sample(64, 3).direction, environment.sample(64, 3).direction)
    assert not torch.equal(environment.sample(64, 3).direction, environment.sample(64, 4).direction)


def test_what_is_hidden_is_not_lit() -> None:
    lights = Environment(sky()).texels()
    finish = (torch.ones(2, 3), torch.ones(2, 1), torch.zeros(2, 1))
    visible = torch.stack([torch.ones(len(lights.direction)), torch.zeros(len(lights.direction))])
    found = shade(UP.expand(2, 3), UP.expand(2, 3), *finish, lights, visible)
    assert bool((found[0] > 0).all()) and torch.equal(found[1], torch.zeros(3))


@pytest.mark.parametrize("radiance", [torch.zeros(4, 4), torch.full((3, 4, 8), torch.nan), -torch.ones(3, 4, 8)])
def test_no_environment_is_refused(radiance: Tensor) -> None:
    with pytest.raises(ValueError, match="radiance"):
        Environment(radiance)


def test_a_black_environment_cannot_be_sampled() -> None:
    with pytest.raises(ValueError, match="black"):
        Environment(torch.zeros(3, 4, 8)).sample(4)
