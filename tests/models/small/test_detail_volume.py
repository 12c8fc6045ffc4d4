"""The finer volume: where rays meet what the coarse one found, and what cells know of colours there."""

import torch
import trimesh
from torch import Tensor

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.raster.rasterize import interpolate, rasterize_views
from arm_blender.graphics.visual_hull import Outlines, signed_silhouette_distance
from arm_blender.graphics.voxels import cell_centers
from arm_blender.models.network_views import network_views
from arm_blender.models.small.detail_volume import COLORS, GEOMETRY, SEEN, DetailVolume, meets
from arm_blender.models.small.feature_volume import halved, object_colors
from arm_blender.models.small.hull_views import HullViews
from arm_blender.structures import TriangleMesh, stack_cameras

from ..balls import ball_views
from .test_volume_georm import TINY

RADIUS = 0.6


def ball_outlines(size: int = 64) -> Outlines:
    views = network_views(ball_views(RADIUS, size), TINY)
    return Outlines(views.silhouette, views.c2w, views.K)


def ball_logit(grid: int) -> Tensor:
    """(1, 1, grid, grid, grid) positive inside a ball that is smaller than its outlines say."""
    return (0.4 - cell_centers(grid, torch.device("cpu")).norm(dim=1)).view(1, 1, grid, grid, grid) / 0.02


def test_a_ray_through_the_middle_meets_a_ball_at_its_radius():
    depth = meets(ball_outlines(), ball_logit(32), 64)[0, :, 0]
    middle = depth[:, 31:33, 31:33]
    assert float((middle + 0.4).abs().max()) < 0.02


def test_a_ray_that_meets_nothing_sees_the_far_side():
    outlines = ball_outlines()
    depth = meets(outlines, ball_logit(32), 64)[0, :, 0]
    # The disc of the outlines is larger than the ball.
    assert float(depth[:, 31, 14].min()) == 1.0
    assert float(meets(outlines, torch.full((1, 1, 8, 8, 8), -1.0), 16).min()) == 1.0


@torch.no_grad()
def test_where_the_surface_is_the_views_agree_on_its_colours():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    mesh = TriangleMesh(torch.tensor(sphere.vertices, dtype=torch.float32), torch.tensor(sphere.faces))
    cameras = [orbit_camera(60.0 * i, (20.0, -10.0)[i % 2], 4.0, 40.0, 160, 160) for i in range(6)]
    fragments = rasterize_views(mesh.vertices, mesh.faces, cameras)
    place = torch.stack([interpolate(mesh.vertices, mesh.faces, fragments[i]) for i in range(6)])
    coverage = fragments.mask.float()
    images = torch.cat([(0.5 + 0.5 * torch.sin(4.0 * place)) * coverage[:, None], coverage[:, None]], dim=1)
    c2w, K = (x[None] for x in stack_cameras(cameras))
    silhouette = torch.stack([coverage, signed_silhouette_distance(coverage)], dim=1)[None]
    outlines = Outlines(silhouette, c2w, K)
    views = HullViews(outlines, torch.zeros(1, 6, 1, 1, 1), object_colors(images, 0.0, 80)[None])
    caught = []
    volume = DetailVolume(grid=16, coarse=4, channels=4, hull_gain=50.0)
    volume.lift.register_forward_hook(lambda module, inputs, output: caught.append(inputs[0]))
    radius = cell_centers(16, torch.device("cpu")).norm(dim=1).view(1, 1, 16, 16, 16)
    volume(views, torch.zeros(1, 4, 16, 16, 16), (RADIUS - radius) / 0.02)
    cells = caught[0][0, 4 + GEOMETRY :]  # (2 * COLORS, 32, 32, 32)
    assert len(cells) == len(SEEN) * COLORS
    spread, seen = cells[3:6].mean(dim=0).flatten(), cells[6].flatten()
    centers = cell_centers(32, torch.device("cpu"))
    distance = centers.norm(dim=1) - RADIUS
    near, before = (distance.abs() < 0.03) & (seen > 0.5), (distance > 0.15) & (distance < 0.3) & (seen > 0.5)
    assert int(near.sum()) > 300 and int(before.sum()) > 50
    assert float(spread[near].mean()) < 0.3 * float(spread[before].mean())


def test_colours_of_twice_the_size_are_those_of_half_the_picture():
    images = torch.rand(6, 4, 64, 64, generator=torch.Generator().manual_seed(0))
    images[:, 3] = (images[:, 3] > 0.5).float()
    images[:, :3] *= images[:, 3:]
    expected = object_colors(images, 0.0, 16)
    torch.testing.assert_close(halved(object_colors(images, 0.0, 32)[None])[0], expected)
