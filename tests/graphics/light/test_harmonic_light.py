"""Nine harmonics of light: environments that have them, and shading against the integral over such an environment."""

import pytest
import torch
from torch.nn import functional

from arm_blender.graphics.light.environment import Environment
from arm_blender.graphics.light.environment import shade as by_integral
from arm_blender.graphics.light.harmonic_light import environment_of, harmonics_of, lobe, shade
from arm_blender.graphics.light.spherical_harmonics import COUNT, GATHERED, WHITE, gathered

AXES = {"+x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0), "+z": (0.0, 0.0, 1.0)}


def soft_light(axis: torch.Tensor) -> torch.Tensor:
    """(9, 3) of red, green and blue radiance of 0.8, 0.4 and 0.2 times (1 + d . axis)^2."""
    texels = Environment(torch.ones(3, 128, 256)).texels()
    color = torch.tensor([0.8, 0.4, 0.2])
    radiance = (1.0 + texels.direction @ axis).square()[:, None] * color
    height, width = 128, 256
    return harmonics_of(Environment(radiance.T.reshape(3, height, width).contiguous()))


def unit(count: int, seed: int) -> torch.Tensor:
    return functional.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(seed)), dim=1)


def test_light_from_everywhere_is_an_even_environment():
    light = torch.zeros(COUNT, 3)
    light[0] = WHITE * torch.tensor([0.5, 1.0, 2.0])
    radiance = environment_of(light).radiance
    torch.testing.assert_close(
        radiance, torch.tensor([0.5, 1.0, 2.0])[:, None, None].expand(3, 64, 128), rtol=2e-3, atol=0
    )


@pytest.mark.parametrize("side", AXES)
def test_an_environment_has_the_harmonics_and_shines_from_where_they_say(side):
    axis = torch.tensor(AXES[side])
    light = soft_light(axis)
    environment = environment_of(light)
    torch.testing.assert_close(harmonics_of(environment), light, atol=1e-2, rtol=0.0)
    ahead, behind = environment.look_up(torch.stack([axis, -axis]))
    assert bool((ahead > 3.0 * behind).all())
    assert bool((ahead[0] > ahead[1]) & (ahead[1] > ahead[2]))


def test_harmonics_that_no_light_has_are_met_by_one_that_is_nowhere_negative():
    light = torch.zeros(COUNT, 3)
    light[0], light[3] = WHITE, 3.0 * WHITE  # No light has more of order 1 than sqrt(3) of order 0.
    environment = environment_of(light)
    assert bool(environment.radiance.isfinite().all()) and float(environment.radiance.min()) >= 0.0
    found = harmonics_of(environment)
    torch.testing.assert_close(found[0], light[0], rtol=1e-3, atol=0.0)
    assert float(found[3].min()) > 1.05 * WHITE  # The sun along +X.


def test_black_and_negative_harmonics_are_a_dark_environment():
    for level in (0.0, -1.0):
        radiance = environment_of(torch.full((COUNT, 3), level)).radiance
        assert bool(radiance.isfinite().all()) and 0.0 <= float(radiance.mean()) < 2e-3


def test_a_mirror_leaves_all_and_the_roughest_lobe_what_a_cosine_leaves():
    found = lobe(torch.tensor([[0.0], [1.0]]))
    torch.testing.assert_close(found[0], torch.ones(COUNT), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(found[1], torch.tensor(GATHERED), atol=1e-5, rtol=0.0)
    assert bool((lobe(torch.linspace(0, 1, 30)[:, None]).diff(dim=0) <= 1e-6).all())


def test_a_rough_white_ball_sends_back_its_irradiance():
    light, normal = soft_light(torch.tensor([0.6, 0.0, 0.8])), unit(40, 0)
    ones = torch.ones(40, 1)
    found = shade(normal, normal, torch.ones(40, 3), ones, 0.0 * ones, light)
    torch.testing.assert_close(found, gathered(normal) @ light, atol=0.02, rtol=0.05)


@pytest.mark.parametrize(("metallic", "roughness"), [(0.0, 0.3), (0.0, 0.8), (1.0, 0.5), (1.0, 0.8)])
def test_shading_is_near_the_integral_over_the_environment(metallic, roughness):
    light, normal = soft_light(torch.tensor([0.0, -0.6, 0.8])), unit(60, 1)
    view = functional.normalize(normal + 0.7 * unit(60, 2), dim=1)
    albedo = torch.rand(60, 3, generator=torch.Generator().manual_seed(3))
    rough, metal = torch.full((60, 1), roughness), torch.full((60, 1), metallic)
    expected = by_integral(normal, view, albedo, rough, metal, environment_of(light).texels(), form="cycles")
    found = shade(normal, view, albedo, rough, metal, light)
    # Grazing lobes lean towards the normal, and an environment has more than nine harmonics.
    error = float((found - expected).square().mean().sqrt() / expected.square().mean().sqrt())
    assert error < 0.08


def test_what_faces_away_or_is_lit_by_nothing_has_a_colour():
    normal = unit(20, 4)
    dark = torch.zeros(COUNT, 3)
    dark[3] = 5.0  # Negative on one side.
    ones = torch.ones(20, 1)
    for view in (normal, -normal):
        found = shade(normal, view, torch.ones(20, 3), 0.3 * ones, 0.5 * ones, dark)
        assert bool(found.isfinite().all()) and float(found.min()) >= 0.0


def test_the_height_of_an_environment_is_chosen():
    light = soft_light(torch.tensor([1.0, 0.0, 0.0]))
    assert environment_of(light, 16).radiance.shape == (3, 16, 32)
    with pytest.raises(ValueError):
        environment_of(light[:4])
