"""What is said along a view's rays is found again at points, whatever camera the view was taken by."""

import math
from dataclasses import replace

import pytest
import torch

from arm_blender.graphics.cameras import Camera, orbit_camera, project
from arm_blender.graphics.visual_hull import Outlines
from arm_blender.models.network_views import NetworkViews, network_views
from arm_blender.models.small.ray_occupancy import (
    BALL,
    LOCAL,
    REACH,
    WHOLE,
    EncodedRays,
    Frustum,
    RayOccupancy,
    RayOccupancyConfig,
    look,
)
from arm_blender.models.unet import UnetConfig
from arm_blender.structures import ViewSet

from ..balls import ball_views

TINY = RayOccupancyConfig(size=32, unet=UnetConfig(widths=(8, 16), out_channels=8, stem_stride=2), depths=16)
EYES = torch.stack([orbit_camera(a, e, d, 30.0, 8, 8).center for a, e, d in ((0, 10, 6), (140, -15, 3), (250, 70, 9))])


def points(count: int = 500, reach: float = 0.7) -> torch.Tensor:
    return (2.0 * torch.rand(count, 3, generator=torch.Generator().manual_seed(0)) - 1.0) * reach


def outlines_of(views: NetworkViews) -> Outlines:
    return Outlines(views.silhouette, views.c2w, views.K)


def pictured(camera: Camera) -> ViewSet:
    """Two balls of different colours, off the centre, in closed form."""
    row, column = torch.meshgrid(torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij")
    local = torch.stack(
        [(column - camera.K[0, 2]) / camera.K[0, 0], (camera.K[1, 2] - row) / camera.K[1, 1], -torch.ones_like(row)],
        dim=-1,
    )
    rays = torch.nn.functional.normalize(local @ camera.c2w[:3, :3].T, dim=-1)
    image = torch.zeros(4, camera.height, camera.width)
    for center, color in (((0.3, 0.1, 0.4), (0.8, 0.2, 0.1)), ((-0.4, 0.0, -0.2), (0.1, 0.3, 0.7))):
        toward = torch.tensor(center) - camera.center
        off = (toward - (rays @ toward)[..., None] * rays).norm(dim=-1)
        image = torch.where(off < 0.35, torch.tensor([*color, 1.0])[:, None, None], image)
    return ViewSet(image[None], (camera,), torch.ones(1), "balls")


def seen(camera: Camera) -> torch.Tensor:
    views = network_views(pictured(camera), TINY)
    outlines = outlines_of(views)
    return look(views, outlines, Frustum.of(camera.center[None]), TINY.size, TINY.background)


@pytest.mark.parametrize("eye", EYES)
def test_the_ball_fills_the_picture_and_the_origin_is_its_middle(eye):
    frustum = Frustum.of(eye[None])
    rays = frustum.rays(64)[0]
    aside = torch.linalg.cross(rays / rays.norm(dim=1, keepdim=True), -eye.expand_as(rays)).norm(dim=1)
    across = aside.view(64, 64)[31:33].mean(dim=0)  # From the left edge to the right one.
    assert BALL - 0.05 < float(across[0]) < BALL and BALL - 0.05 < float(across[-1]) < BALL
    assert float(frustum.grid(torch.zeros(1, 1, 3)).abs().max()) < 1e-5


@pytest.mark.parametrize("eye", EYES)
def test_points_of_a_pixels_ray_are_looked_up_at_that_pixel(eye):
    frustum, size = Frustum.of(eye[None]), 8
    depth = float(eye.norm()) + 0.5 * REACH
    grid = frustum.grid(eye + frustum.rays(size) * depth)[0].view(size, size, 3)
    centers = (torch.arange(size) + 0.5) / size * 2.0 - 1.0
    torch.testing.assert_close(grid[..., 0], centers.expand(size, size), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(grid[..., 1], centers[:, None].expand(size, size), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(grid[..., 2], torch.full((size, size), 0.5), atol=1e-5, rtol=0.0)


def test_a_field_in_the_frustum_is_found_at_world_points():
    """One that is linear in column, row and depth: between cells it is interpolated without an error."""
    camera = orbit_camera(35.0, 20.0, 5.0, 40.0, 96, 96)
    views = network_views(ball_views(0.9, size=96, views=1), TINY)
    c2w, K = camera.c2w[None, None], camera.K[None, None]
    views = replace(views, c2w=c2w, K=K)
    frustum = Frustum.of(camera.center[None])
    size, depths = 24, 20
    column, depth = (torch.arange(size) + 0.5) / size * 2.0 - 1.0, (torch.arange(depths) + 0.5) / depths * 2.0 - 1.0
    logits = 3.0 * column + 5.0 * column[:, None] + 7.0 * depth[:, None, None]
    network = RayOccupancy(replace(TINY, gain=0.0))
    found = network.occupancy_logit(
        EncodedRays(logits[None, None], logits[None, :2], frustum, outlines_of(views)), points()[None]
    )[0]
    pixels, away = project(points(), camera)  # The camera looks at the origin, so that it is the frustum's.
    half = 48.0 * float(frustum.half / frustum.range) * float(camera.K[0, 0]) / 48.0
    x, y = ((pixels - 48.0) / half).unbind(1)
    torch.testing.assert_close(found, 3.0 * x + 5.0 * y + 7.0 * (away - 5.0) / REACH, atol=1e-3, rtol=0.0)


def test_the_network_sees_the_same_however_the_camera_is_rolled_and_framed():
    camera = orbit_camera(20.0, 10.0, 6.0, 30.0, 160, 160)
    plain = seen(camera)
    assert plain.shape == (1, LOCAL + WHOLE, TINY.size, TINY.size)
    turned = camera.c2w.clone()
    turn = math.radians(30.0)
    turned[:3, :3] = camera.c2w[:3, :3] @ torch.tensor(
        [[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    moved = camera.K + torch.tensor([[0.0, 0.0, 10.0], [0.0, 0.0, -6.0], [0.0, 0.0, 0.0]])
    wide = orbit_camera(20.0, 10.0, 6.0, 36.0, 160, 160)
    for other in (replace(camera, c2w=turned), replace(camera, K=moved), wide):
        error = (seen(other) - plain).abs()
        # Bounds are those of pixels: a picture elsewhere may move them by one.
        assert float(error.mean()) < 0.02 and float(error.flatten(2).mean(dim=2).amax()) < 2.1 / TINY.size


def test_a_mirrored_scene_is_seen_mirrored():
    """So that training on mirror images teaches what holds for both."""
    ball = orbit_camera(0.0, 10.0, 6.0, 30.0, 160, 160)
    views = network_views(pictured(ball), TINY)
    flipped = replace(views, images=views.images.flip(-1), silhouette=views.silhouette.flip(-1))
    plain, mirrored = (
        look(v, outlines_of(v), Frustum.of(ball.center[None]), TINY.size, TINY.background)[0] for v in (views, flipped)
    )
    torch.testing.assert_close(mirrored[:6], plain[:6].flip(-1), atol=1e-4, rtol=0.0)


@torch.no_grad()
def test_beyond_the_silhouette_there_is_nothing_and_within_it_every_ray_meets_something():
    torch.manual_seed(0)
    network = RayOccupancy(TINY).eval()
    encoded = network.encode(network_views(ball_views(0.7, size=160, views=1), TINY))
    p = points(4000, 1.0)
    field = network.filled_logit(encoded, 4096)
    hull = encoded.outlines.hull_distance(p[None])[0]
    assert bool((field(p)[hull < -0.15] < 0.0).all())
    assert bool((network.occupancy_logit(encoded, p[None])[0][hull < -0.15] < 0.0).all())
    highest = encoded.outlines.highest(40, lambda _, q: field(q), 60, -20.0)
    assert float((highest[highest.isfinite()] > 0.0).float().mean()) > 0.9


@torch.no_grad()
def test_the_order_of_views_and_of_objects_means_nothing():
    torch.manual_seed(1)
    network = RayOccupancy(TINY).eval()
    views = network_views(ball_views(0.7, size=96, views=3), TINY)
    parts = ("images", "silhouette", "c2w", "K")
    shuffled = NetworkViews(*(getattr(views, name)[:, [2, 0, 1]] for name in parts))
    p = points()[None]
    plain = network.occupancy_logit(network.encode(views), p)
    torch.testing.assert_close(network.occupancy_logit(network.encode(shuffled), p), plain, atol=1e-4, rtol=0.0)
    single = NetworkViews(*(getattr(views, name)[:, :1] for name in parts))
    other = NetworkViews(*(getattr(views, name)[:, 1:2] for name in parts))
    both = NetworkViews(*(torch.cat([getattr(v, name) for v in (single, other)]) for name in parts))
    together = network.occupancy_logit(network.encode(both), p.expand(2, -1, -1))
    for item, alone in enumerate((single, other)):
        found = network.occupancy_logit(network.encode(alone), p)[0]
        torch.testing.assert_close(together[item], found, atol=1e-4, rtol=0.0)


def test_a_camera_above_or_close_is_no_obstacle():
    for camera in (orbit_camera(0.0, 90.0, 4.0, 40.0, 64, 64), orbit_camera(0.0, 0.0, 1.2, 100.0, 64, 64)):
        assert bool(seen(camera).isfinite().all())
