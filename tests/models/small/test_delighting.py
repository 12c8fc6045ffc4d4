"""Delighting: untrained it takes the light for white; points and views have no order; what none sees says nothing."""

from dataclasses import replace

import pytest
import torch
from torch.nn import functional

from arm_blender.graphics.light.spherical_harmonics import COUNT, WHITE, gathered
from arm_blender.models.atlas_cells import scaled
from arm_blender.models.small.delighting import DARKEST, REFLECTED, Delighting, DelightingConfig, SeenPoints

TINY = DelightingConfig(width=16, view_width=8, tokens=4, heads=2, depth=1)


def random_points(count: int = 60, views: int = 3, seed: int = 0) -> SeenPoints:
    random = torch.Generator().manual_seed(seed)
    normal = functional.normalize(torch.randn(1, count, 3, generator=random), dim=-1)
    color = torch.rand(1, views, count, 3, generator=random)
    visible = torch.rand(1, views, count, generator=random) > 0.4
    visible[:, 0] = True
    eyes = 6.0 * functional.normalize(torch.randn(1, views, 3, generator=random), dim=-1)
    return SeenPoints(0.7 * normal, normal, color, visible, eyes)


def facing(points: SeenPoints) -> torch.Tensor:
    """(P,) bool: some view that sees the point looks at its front."""
    cosine = (points.towards() * points.normal[:, None]).sum(dim=-1)
    return ((cosine > 0.05) & points.visible).any(dim=1)[0]


@pytest.fixture
def model() -> Delighting:
    torch.manual_seed(0)
    model = Delighting(TINY).eval()
    for last in (model.light, model.correction[-1]):
        torch.nn.init.normal_(last.weight, std=0.1)
    return model


def test_untrained_it_divides_by_white_light_and_takes_the_reflection_off():
    points = random_points()
    with torch.no_grad():
        found = Delighting(TINY)(points)
    expected = torch.zeros(1, COUNT, 3)
    expected[:, 0] = WHITE
    torch.testing.assert_close(found.light, expected)
    irradiance = functional.softplus(torch.tensor(5.0)) / 5.0 + DARKEST
    even = points.blended() / irradiance
    torch.testing.assert_close(found.albedo, even.square() / (even + REFLECTED), atol=1e-5, rtol=1e-4)


def test_irradiance_of_the_light_it_tells_is_what_it_divided_by(model):
    points = random_points()
    with torch.no_grad():
        found = model(points)
    irradiance = functional.softplus(5.0 * (gathered(points.normal) @ found.light)) / 5.0 + DARKEST
    even = points.blended() / irradiance
    torch.testing.assert_close(found.even, even.square() / (even + REFLECTED))


def test_neither_points_nor_views_have_an_order(model):
    points = random_points()
    order = torch.randperm(60, generator=torch.Generator().manual_seed(1))
    views = torch.tensor([2, 0, 1])
    turned = replace(
        points, color=points.color[:, views], visible=points.visible[:, views], eyes=points.eyes[:, views]
    ).only(order)
    with torch.no_grad():
        first, second = model(points), model(turned)
    torch.testing.assert_close(first.light, second.light, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(first.albedo[:, order], second.albedo, atol=1e-5, rtol=1e-4)


def test_what_a_view_does_not_see_of_a_point_means_nothing(model):
    points = random_points()
    other = torch.where(points.visible[..., None], points.color, 0.123)
    with torch.no_grad():
        torch.testing.assert_close(model(points).albedo, model(replace(points, color=other)).albedo)


def test_the_light_may_be_read_from_some_points_and_told_to_all(model):
    points, some = random_points(), torch.arange(0, 60, 2)
    with torch.no_grad():
        found, alone = model(points, some), model(points.only(some))
    torch.testing.assert_close(found.light, alone.light)
    torch.testing.assert_close(found.albedo[:, some], alone.albedo)


def test_its_gain_lies_between_what_the_light_leaves_and_the_albedo(model):
    points = random_points()
    with torch.no_grad():
        (gain, light), found = model.log_gain(points), model(points)
    torch.testing.assert_close(light, found.light[0])
    blended, bounds = points.blended()[0], [x[0].clamp(0.0, 1.0) for x in (found.even, found.albedo)]
    made = scaled(blended, gain)
    assert bool((made >= torch.minimum(*bounds) - 1e-5).all()) and bool((made <= torch.maximum(*bounds) + 1e-5).all())
    assert float((made - bounds[0]).abs().max()) > 1e-3 and float((made - bounds[1]).abs().max()) > 1e-3


def test_extreme_colours_and_a_single_point_give_numbers(model):
    for count in (1, 60):
        points = random_points(count)
        for level in (0.0, 1.0):
            with torch.no_grad():
                gain, _ = model.log_gain(replace(points, color=torch.full_like(points.color, level)))
            assert bool(gain.isfinite().all())


def test_the_blend_trusts_who_looks_squarely():
    normal = torch.tensor([[[0.0, 0.0, 1.0]]])
    eyes = torch.tensor([[[0.0, 0.0, 4.0], [4.0, 0.0, 4.0]]])  # cosines 1 and 1/sqrt(2)
    color = torch.tensor([[[[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]]])
    points = SeenPoints(torch.zeros(1, 1, 3), normal, color, torch.ones(1, 2, 1, dtype=torch.bool), eyes)
    torch.testing.assert_close(points.blended()[0, 0], torch.tensor([0.8, 0.2, 0.0]))
    assert bool(facing(points).all())
