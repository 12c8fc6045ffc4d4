"""Silhouettes are filled where something was believed in, and nothing is made where no view shows anything."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.meshes import face_normals
from arm_blender.graphics.raster.rasterize import rasterize_views
from arm_blender.graphics.silhouette_fill import MOST, ROUNDS, fill
from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, extract
from arm_blender.graphics.visual_hull import Outlines
from arm_blender.graphics.voxels import sample_volume
from arm_blender.models.network_views import network_views
from arm_blender.structures import TriangleMesh

from ..models.balls import ball_views
from ..models.small.test_volume_georm import TINY

RADIUS = 0.6
Field = Callable[[Tensor], Tensor]


def outlines(size: int = 160, views: int = 6) -> Outlines:
    seen = network_views(ball_views(RADIUS, size, views=views), TINY)
    return Outlines(seen.silhouette, seen.c2w, seen.K)


def ball(radius: float) -> Field:
    """Logits as of a network: a signed distance over a temperature."""
    return lambda points: (radius - points.norm(dim=1)) / 0.02


def filled(field: Field, seen: Outlines) -> Field:
    added = fill(field, seen, 4096)
    return lambda points: field(points) + sample_volume(added, points[None])[0, :, 0]


def surface(field: Field) -> TriangleMesh:
    return extract(field, IsosurfaceConfig(64, iso=0.0))


def overlap(mesh: TriangleMesh, seen: Outlines) -> float:
    """IoU of the mesh's silhouettes and those seen."""
    size = seen.silhouette.shape[-1]
    cameras = [Camera(c2w, K, size, size) for c2w, K in zip(seen.c2w[0], seen.K[0], strict=True)]
    found, truth = rasterize_views(mesh.vertices, mesh.faces, cameras).mask, seen.silhouette[0, :, 0] > 0.5
    return float((found & truth).sum() / (found | truth).sum())


@torch.no_grad()
@pytest.mark.parametrize("views", [1, 6])
def test_a_ball_that_shrank_fills_its_silhouettes_again(views):
    seen, shrunk = outlines(views=views), ball(RADIUS - 0.04)
    assert overlap(surface(shrunk), seen) < 0.9
    assert overlap(surface(filled(shrunk, seen)), seen) > 0.93


@torch.no_grad()
def test_what_is_filled_stays_smooth():
    """Raised pixel by pixel, the surface would stand in fins along the outlines."""
    mesh = surface(filled(ball(RADIUS - 0.04), outlines()))
    outwards = torch.nn.functional.normalize(mesh.vertices[mesh.faces].mean(dim=1), dim=1)
    facing = (face_normals(mesh.vertices, mesh.faces) * outwards).sum(dim=1)
    assert float((facing > 0.8).float().mean()) > 0.99


@torch.no_grad()
def test_what_fills_its_silhouettes_stays_as_it_is():
    assert float(fill(ball(RADIUS + 0.05), outlines(), 4096).abs().max()) == 0.0


@torch.no_grad()
def test_nothing_is_made_where_nothing_was_believed_in():
    seen, points = outlines(), 2.0 * torch.rand(2000, 3, generator=torch.Generator().manual_seed(0)) - 1.0
    nothing = filled(lambda p: p.new_full((len(p),), -2.0 * MOST * ROUNDS), seen)
    assert bool((nothing(points) < 0.0).all())
    blank = Outlines(torch.zeros_like(seen.silhouette), seen.c2w, seen.K)
    assert float(fill(ball(RADIUS), blank, 4096).abs().max()) == 0.0
