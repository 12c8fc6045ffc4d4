"""The surface of a field as training sees it: where a ball is, how its pictures follow its size, and what is finite."""

import math

import pytest
import torch
from torch import Tensor

from arm_blender.graphics.cameras import Camera, orbit_camera
from training.surface_rendering import iso_surface, surface_maps

SIZE = 64
CPU = torch.device("cpu")


def views(count: int = 3) -> list[Camera]:
    return [orbit_camera(70.0 * i, 25.0 * (i - 1), 4.0, 40.0, SIZE, SIZE) for i in range(count)]


def ball(radius: Tensor | float, center: Tensor | None = None):
    def field(points: Tensor) -> Tensor:
        moved = points if center is None else points - center
        return 30.0 * (radius - moved.norm(dim=-1))

    return field


def test_vertices_lie_on_the_ball_and_move_with_its_radius():
    radius = torch.tensor(0.6, requires_grad=True)
    surface = iso_surface(ball(radius), 48, CPU)
    distance = surface.vertices.norm(dim=-1)
    assert float((distance - 0.6).detach().abs().max()) < 2e-3
    # An edge of the grid meets the sphere at an angle: the vertex moves along the edge, and outward by one for one.
    outward = torch.autograd.grad(distance.mean(), radius)[0]
    assert float(outward) == pytest.approx(1.0, abs=0.05)


def test_pictures_of_a_ball_are_true():
    camera, surface = views()[1], iso_surface(ball(0.6), 48, CPU)
    maps = surface_maps(surface, [camera])
    middle = (0, SIZE // 2, SIZE // 2)
    # The pixel beside the centre, whose ray passes the middle of the ball at a few thousandths.
    assert float(maps.depth[middle]) == pytest.approx(4.0 - 0.6, abs=5e-3)
    toward = camera.c2w[:3, 2]
    assert float((maps.normal[:, :, *middle[1:]][0] * toward).sum()) == pytest.approx(1.0, abs=5e-3)
    disc = math.pi * (float(camera.K[0, 0]) * math.tan(math.asin(0.6 / 4.0))) ** 2
    assert float(maps.mask.sum()) == pytest.approx(disc, rel=0.02)
    outside = maps.mask == 0.0
    assert not maps.depth[outside].any() and not maps.normal.movedim(1, -1)[outside].any()


def test_the_silhouette_follows_the_radius_as_its_area_does():
    """The area's derivative in closed form: only outlines move pixels, so anti-aliasing carries all of it."""
    radius = torch.tensor(0.6, requires_grad=True)
    maps = surface_maps(iso_surface(ball(radius), 48, CPU), views())
    found = torch.autograd.grad(maps.mask.sum() / len(maps.mask), radius)[0]
    focal = float(views()[0].K[0, 0])
    # The area is pi f^2 r^2 / (d^2 - r^2) at distance d.
    expected = 2.0 * math.pi * focal**2 * 0.6 * 16.0 / (16.0 - 0.36) ** 2
    assert float(found) == pytest.approx(expected, rel=0.1)


def test_a_loss_on_pictures_finds_a_balls_place_and_size():
    """From a ball elsewhere, by mask, depth and normals alone."""
    truth = surface_maps(iso_surface(ball(0.55, torch.tensor([0.1, -0.1, 0.05])), 40, CPU), views())
    radius, center = torch.tensor(0.4, requires_grad=True), torch.zeros(3, requires_grad=True)
    optimizer = torch.optim.Adam([radius, center], 0.02)
    for _ in range(40):
        maps = surface_maps(iso_surface(ball(radius, center), 32, CPU), views())
        loss = (maps.mask - truth.mask).square().mean() + 0.5 * (maps.depth - truth.depth).abs().mean()
        loss = loss + 0.2 * (maps.normal - truth.normal).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert float(radius.detach()) == pytest.approx(0.55, abs=0.03)
    assert center.detach().tolist() == pytest.approx([0.1, -0.1, 0.05], abs=0.04)


@pytest.mark.parametrize("value", [-1e4, 1e4, -math.inf, math.nan], ids=str)
def test_a_field_that_is_the_same_everywhere_has_no_surface_to_move(value):
    assert iso_surface(lambda points: points[..., 0] * 0.0 + value, 16, CPU) is None


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_gradients_are_finite_however_steep_the_field(scale):
    """Raw densities of 1e4 on both sides of the surface, and of nearly nothing."""
    radius = torch.tensor(0.6, requires_grad=True)
    surface = iso_surface(lambda points: scale / 30.0 * ball(radius)(points), 32, CPU)
    maps = surface_maps(surface, views(1))
    (maps.mask.sum() + maps.depth.sum() + maps.normal.square().sum()).backward()
    assert float(surface.vertices.detach().norm(dim=-1).sub(0.6).abs().max()) < 5e-3
    assert bool(radius.grad.isfinite()) and float(radius.grad) > 0.0


def test_a_surface_that_the_box_cuts_moves_where_it_is_inside():
    radius = torch.tensor(1.2, requires_grad=True)
    surface = iso_surface(ball(radius), 32, CPU)
    maps = surface_maps(surface, views(1))
    maps.depth.sum().backward()
    assert bool(radius.grad.isfinite()) and float(surface.vertices.detach().abs().max()) <= 1.0
