"""The visual hull of analytic masks of a sphere."""

import math

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.errors import EmptyMeshError
from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.structures import TriangleMesh, ViewSet
from training.evaluation.trials.hull_mesh import silhouette_field, visual_hull

RADIUS = 0.7


def sphere_mask(camera: Camera) -> torch.Tensor:
    """(H, W) alpha of the sphere at the origin: its silhouette is a cone around the camera's way to it."""
    x, y = torch.meshgrid(torch.arange(camera.width) + 0.5, torch.arange(camera.height) + 0.5, indexing="xy")
    directions = torch.stack(
        [
            (x - camera.K[0, 2]) / camera.K[0, 0],
            (camera.K[1, 2] - y) / camera.K[1, 1],
            -torch.ones_like(x),
        ]
    )
    distance = float(camera.center.norm())
    angle = torch.acos(-torch.nn.functional.normalize(directions, dim=0)[2])
    pixels_inside = (math.asin(RADIUS / distance) - angle) * float(camera.K[0, 0])
    return (pixels_inside + 0.5).clamp(0.0, 1.0)


def sphere_views(cameras: list[Camera]) -> ViewSet:
    alpha = torch.stack([sphere_mask(camera) for camera in cameras])
    images = torch.cat([torch.zeros(len(cameras), 3, *alpha.shape[1:]), alpha[:, None]], dim=1)
    return ViewSet(images, tuple(cameras), torch.ones(len(cameras)), "sphere")


def around(count: int) -> list[Camera]:
    """Cameras spread evenly over all directions (a Fibonacci lattice)."""
    heights = [1.0 - (2.0 * k + 1.0) / count for k in range(count)]
    return [
        orbit_camera(137.508 * k, math.degrees(math.asin(height)), 4.0, 30.0, 128, 128)
        for k, height in enumerate(heights)
    ]


def volume(mesh: TriangleMesh) -> float:
    return trimesh.Trimesh(mesh.vertices.numpy(), mesh.faces.numpy(), process=False).volume


def test_the_hull_contains_the_sphere():
    field = silhouette_field(sphere_views(around(6)))
    directions = torch.nn.functional.normalize(torch.randn(2000, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    pixel = 2.0 * 4.0 * math.tan(math.radians(15.0)) / 128
    assert (field((RADIUS - pixel) * directions) >= 0.5).all()
    assert (field(1.0 * directions) < 0.5).any()


def test_the_hull_shrinks_to_the_sphere_as_views_are_added():
    truth = 4.0 / 3.0 * math.pi * RADIUS**3
    volumes = [volume(visual_hull(sphere_views(around(count)), 48)) for count in (3, 8, 40)]
    assert volumes[0] > volumes[1] > volumes[2] > 0.98 * truth
    assert volumes[2] == pytest.approx(truth, rel=0.04)


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        (((0, 0), (90, 0)), 16.0 / 3.0 * RADIUS**3),
        (((0, 0), (90, 0), (0, 90)), (16.0 - 8.0 * math.sqrt(2.0)) * RADIUS**3),
    ],
    ids=["bicylinder", "tricylinder"],
)
def test_distant_orthogonal_views_leave_the_solid_of_steinmetz(angles, expected):
    fovy_deg = math.degrees(2.0 * math.atan(1.0 / 200.0))
    cameras = [orbit_camera(azimuth, elevation, 200.0, fovy_deg, 128, 128) for azimuth, elevation in angles]
    assert volume(visual_hull(sphere_views(cameras), 64)) == pytest.approx(expected, rel=0.02)


def test_what_a_view_does_not_show_is_outside():
    field = silhouette_field(sphere_views([orbit_camera(0.0, 0.0, 4.0, 10.0, 64, 64)]))
    beside, behind = torch.tensor([[0.9, 0.0, 0.0]]), torch.tensor([[0.0, -8.0, 0.0]])
    assert float(field(beside)) == 0.0
    assert float(field(behind)) == 0.0
    assert float(field(torch.zeros(1, 3))) == 1.0


def test_masks_that_share_no_point_have_no_hull():
    views = sphere_views(around(3))
    with pytest.raises(EmptyMeshError):
        visual_hull(ViewSet(torch.zeros_like(views.images), views.cameras, views.weights, "nothing"), 16)


def test_an_independent_count_of_cells_agrees_on_the_volume():
    views = sphere_views(around(5))
    axis = np.linspace(-1.0, 1.0, 48, dtype=np.float32)
    points = torch.tensor(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3))
    counted = float((silhouette_field(views)(points) > 0.5).sum()) * (2.0 / 47.0) ** 3
    assert volume(visual_hull(views, 48)) == pytest.approx(counted, rel=0.02)
