"""Silhouettes are filled where something was believed in, and nothing is made where no view shows anything."""

import pytest
import torch
from torch import Tensor

from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.isosurface import IsosurfaceConfig, extract
from arm_blender.graphics.rasterize import rasterize_views
from arm_blender.models.reconstruction import network_views
from arm_blender.models.silhouette_fill import CARVED, MOST, SilhouetteFill
from arm_blender.models.visual_hull import Outlines

from .test_reconstruction import TINY, ball_views

RADIUS = 0.6


def outlines(size: int = 160, views: int = 6) -> Outlines:
    seen = network_views(ball_views(RADIUS, size, views=views), TINY)
    return Outlines(seen.silhouette, seen.c2w, seen.K)


def ball(radius: float):
    """Logits as of a network: a signed distance over a temperature."""
    return lambda points: (radius - points.norm(dim=1)) / 0.02


def silhouettes(field, seen: Outlines) -> Tensor:
    surface = extract(field, IsosurfaceConfig(64, iso=0.0))
    size = seen.silhouette.shape[-1]
    cameras = [Camera(c2w, K, size, size) for c2w, K in zip(seen.c2w[0], seen.K[0], strict=True)]
    return rasterize_views(surface.vertices, surface.faces, cameras).mask


def overlap(a: Tensor, b: Tensor) -> float:
    return float((a & b).sum() / (a | b).sum())


@torch.no_grad()
@pytest.mark.parametrize("views", [1, 6])
def test_a_ball_that_shrank_fills_its_silhouettes_again(views):
    seen, shrunk = outlines(views=views), ball(RADIUS - 0.04)
    fill = SilhouetteFill.of(shrunk, seen, 4096)
    truth = seen.silhouette[0, :, 0] > 0.5
    assert overlap(silhouettes(shrunk, seen), truth) < 0.9
    assert overlap(silhouettes(lambda p: fill.raised(p, shrunk(p)), seen), truth) > 0.96


@torch.no_grad()
def test_what_fills_its_silhouettes_stays_as_it_is():
    seen, large = outlines(), ball(RADIUS + 0.05)
    fill = SilhouetteFill.of(large, seen, 4096)
    points = 2.0 * torch.rand(2000, 3, generator=torch.Generator().manual_seed(0)) - 1.0
    torch.testing.assert_close(fill.raised(points, large(points)), large(points))


@torch.no_grad()
def test_only_what_is_believed_in_most_along_a_ray_is_raised():
    seen, shrunk = outlines(), ball(RADIUS - 0.04)
    fill = SilhouetteFill.of(shrunk, seen, 4096)
    # A ball's rim lies on a circle around the view's axis; off that circle along the same rays nothing is raised.
    c2w = seen.c2w[0, 0]
    aside, axis = c2w[:3, 0], c2w[:3, 2]
    rim, before = (RADIUS * aside)[None], (RADIUS * aside + 0.3 * axis)[None]
    others = Outlines(seen.silhouette[:, :1], seen.c2w[:, :1], seen.K[:, :1])
    alone = SilhouetteFill(others, fill.lack[:, :1])
    assert float(alone.raised(rim * 0.99, shrunk(rim * 0.99)) - shrunk(rim * 0.99)) > 0.5
    assert float(alone.raised(before, shrunk(before)) - shrunk(before)) < 0.01


@torch.no_grad()
def test_nothing_is_made_where_nothing_was_believed_in():
    seen = outlines()
    nothing = SilhouetteFill.of(lambda points: points.new_full((len(points),), -2.0 * MOST), seen, 4096)
    points = 2.0 * torch.rand(2000, 3, generator=torch.Generator().manual_seed(0)) - 1.0
    assert bool((nothing.raised(points, torch.full((2000,), -2.0 * MOST)) < 0.0).all())
    blank = Outlines(torch.zeros_like(seen.silhouette), seen.c2w, seen.K)
    unseen = SilhouetteFill.of(ball(RADIUS), blank, 4096)
    logit = ball(RADIUS)(points) - CARVED
    torch.testing.assert_close(unseen.raised(points, logit), logit)
