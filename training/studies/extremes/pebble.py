"""A pebble with bumps and a pattern, its pictures, and how far a mesh lies from it: all in closed form."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.graphics.raster.rasterize import interpolate, rasterize
from arm_blender.graphics.surface.isosurface import extract
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig
from arm_blender.structures import TriangleMesh, ViewSet

SIDE = 160
"""Pixels of a picture."""

DIRECTIONS = ((30.0, 20.0), (90.0, -10.0), (150.0, 20.0), (210.0, -10.0), (270.0, 20.0), (330.0, -10.0))
CAMERAS = tuple(orbit_camera(*direction, 6.0, 24.0, SIDE, SIDE) for direction in DIRECTIONS)


def radius(points: Tensor) -> Tensor:
    """(N,) of the pebble in the directions of points (N, 3)."""
    x, y, z = torch.nn.functional.normalize(points, dim=1).unbind(dim=1)
    return 0.7 + 0.06 * torch.sin(4.0 * x + 1.0) * torch.cos(3.0 * y) + 0.05 * torch.sin(5.0 * z) * x


def wrong_radius(points: Tensor) -> Tensor:
    """(N,) as `radius`, as a network might know it."""
    x, y, z = torch.nn.functional.normalize(points, dim=1).unbind(dim=1)
    return radius(points) + 0.035 * torch.sin(6.0 * y + 2.0 * z) - 0.015 * torch.cos(5.0 * x)


def ball(shape: Callable[[Tensor], Tensor], grid: int) -> TriangleMesh:
    """The surface at the distances `shape` from the origin."""
    return extract(lambda p: 20.0 * (shape(p) - p.norm(dim=1)), IsosurfaceConfig(grid, iso=0.0))


def distance(mesh: TriangleMesh) -> float:
    """How far the vertices of a mesh lie from the pebble, in the mean, along the radius."""
    return float((mesh.vertices.norm(dim=1) - radius(mesh.vertices)).abs().mean())


def pattern(points: Tensor) -> Tensor:
    """(N, 3) linear colours in [0.1, 0.9]: waves in many directions, nowhere alike."""
    generator = torch.Generator().manual_seed(7)
    waves = torch.randn(3, 24, 3, generator=generator) * 12.0
    phases = torch.rand(3, 24, generator=generator) * 6.3
    sums = torch.stack([torch.sin(points @ w.T + p).mean(dim=1) for w, p in zip(waves, phases, strict=True)], dim=1)
    return (0.5 + 1.2 * sums).clamp(0.1, 0.9)


def pictures(mesh: TriangleMesh, cameras: Sequence[Camera] = CAMERAS, name: str = "pebble") -> ViewSet:
    """Four samples a pixel, so that outlines are soft."""
    images = []
    for camera in cameras:
        fine = camera.resized(2 * camera.width, 2 * camera.height)
        fragments = rasterize(mesh.vertices, mesh.faces, fine)
        points = interpolate(mesh.vertices, mesh.faces, fragments)
        colors = pattern(points.flatten(1).T).T.view_as(points) * fragments.mask
        shown = torch.nn.functional.avg_pool2d(torch.cat([colors, fragments.mask[None]]), 2)
        images.append(torch.cat([shown[:3] / shown[3:].clamp(min=1e-6), shown[3:]]))
    return ViewSet(torch.stack(images), tuple(cameras), torch.ones(len(cameras)), name)


def with_shifted_mask(views: ViewSet, by: float = 0.03) -> ViewSet:
    """One mask stands to the right by a share of the picture."""
    images = views.images.clone()
    images[2, 3] = torch.roll(images[2, 3], round(by * SIDE), dims=1)
    return replace(views, images=images)


def with_another_picture(views: ViewSet) -> ViewSet:
    """One picture is that of another view."""
    images = views.images.clone()
    images[2] = images[4]
    return replace(views, images=images)


def with_varying_exposure(views: ViewSet) -> ViewSet:
    """By 30 % up and down."""
    gains = torch.tensor([1.3, 0.7, 1.0, 0.7, 1.3, 1.0])[:, None, None, None]
    colors = (views.images[:, :3] * gains).clamp(max=1.0)
    return replace(views, images=torch.cat([colors, views.images[:, 3:]], dim=1))


def with_turned_cameras(views: ViewSet) -> ViewSet:
    """Each by half a degree about itself, and the other way."""
    return replace(views, cameras=tuple(turned(camera, index) for index, camera in enumerate(views.cameras)))


def turned(camera: Camera, seed: int) -> Camera:
    """Half a degree about any axis through its pinhole."""
    axis = torch.nn.functional.normalize(torch.randn(3, generator=torch.Generator().manual_seed(seed)), dim=0)
    x, y, z = (axis * torch.pi / 360.0).tolist()
    turn = torch.eye(4)
    turn[:3, :3] = torch.matrix_exp(torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
    return replace(camera, c2w=camera.c2w @ turn)


def slab(top: Callable[[Tensor], Tensor], grid: int) -> TriangleMesh:
    """A slab 1.4 wide and 0.6 high whose upper side has heights `top` of points (N, 3)."""

    def inside(points: Tensor) -> Tensor:
        x, y, z = points.unbind(dim=1)
        walls = torch.minimum(0.7 - x.abs(), 0.7 - y.abs())
        return 20.0 * torch.minimum(walls, torch.minimum(top(points) - z, z + 0.3))

    return extract(inside, IsosurfaceConfig(grid, iso=0.0))


def dent(points: Tensor) -> Tensor:
    """(N,) heights of a plane with a hollow 0.06 deep in its middle."""
    return 0.3 - 0.06 * torch.exp(-points[:, :2].square().sum(dim=1) / 0.06)
