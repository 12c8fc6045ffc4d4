"""The iso-surface of a field as a mesh that a loss on pictures can move, and its mask, depth and normals.

Where the surface is, is found without a gradient. Each of its vertices lies on an edge of the grid, where the field's
values at both ends decide: they are asked again with one, and the vertex is their linear interpolation (the paper's
DiffMC does the same on a dense grid). Pictures are rasterised; outlines move pixels by anti-aliasing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from arm_blender.errors import EmptyMeshError
from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.meshes import vertex_normals
from arm_blender.graphics.raster.differentiable import antialias, with_gradient
from arm_blender.graphics.raster.rasterize import interpolate, rasterize_views
from arm_blender.graphics.surface.isosurface import crossed_edges, vertices_from_densities
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig

from .losses import SurfaceMaps
from .volume_rendering import RawDensity

POINTS_AT_ONCE = 2**16
"""Bounds the memory: so many points are decoded at a time, and again for the gradient."""


@dataclass(frozen=True)
class Surface:
    """A mesh whose vertices the field moves.

    Attributes:
        vertices: (N, 3) world, differentiable.
        faces: (F, 3) int64, counter-clockwise seen from outside.
    """

    vertices: Tensor
    faces: Tensor


def iso_surface(field: RawDensity, resolution: int, device: torch.device) -> Surface | None:
    """The surface that bounds {field > 0} in the box.

    Args:
        field: of one object, (1, P, 3) world points to (1, P); over its iso value.
        resolution: samples of the grid along a side.
    Returns:
        None where no vertex depends on the field: it is nowhere above zero, or everywhere, and the surface the box's.
    """

    def values(points: Tensor) -> Tensor:
        return field(points[None])[0]

    try:
        edges = crossed_edges(values, IsosurfaceConfig(resolution, iso=0.0, chunk=POINTS_AT_ONCE), device=device)
    except EmptyMeshError:
        return None
    if not bool((edges.a != edges.b).any()):
        return None
    ends = torch.cat([edges.a, edges.b])
    raw = torch.cat([checkpoint(values, part, use_reentrant=False) for part in ends.split(POINTS_AT_ONCE)])
    # An end that rounding has put on the other side meanwhile: the vertex stays on its edge.
    a, b = raw.float().chunk(2)
    vertices = vertices_from_densities(edges.a, edges.b, a, b, 0.0)
    return Surface(vertices, edges.faces)


def surface_maps(surface: Surface, cameras: Sequence[Camera]) -> SurfaceMaps:
    """What each of V cameras of one size sees, differentiable in the vertices."""
    vertices, faces = surface.vertices, surface.faces
    fragments = rasterize_views(vertices.detach(), faces, cameras)
    normals = vertex_normals(vertices, faces)
    views = []
    for index, camera in enumerate(cameras):
        own = with_gradient(fragments[index], vertices, faces, camera)
        normal = torch.nn.functional.normalize(interpolate(normals, faces, own), dim=0, eps=1e-6)
        depth = torch.where(own.mask, own.depth, 0.0)
        sharp = torch.cat([own.mask[None].to(depth.dtype), depth[None], normal])  # (5, H, W)
        views.append(antialias(sharp, vertices, faces, own, camera))
    maps = torch.stack(views)
    return SurfaceMaps(maps[:, 0], maps[:, 1], maps[:, 2:])
