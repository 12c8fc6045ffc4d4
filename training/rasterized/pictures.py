"""Training pictures on the fly: random materials, light and views on known shapes, rasterised and never stored.

A rig has the arrays of a rendered one (`shards.py`), so that stages can take it in its place, and one more: the kind of
material at each pixel. A shape is made ready once (`rasterized_surface`); what is kept of it serves every rig.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from arm_blender.errors import ArmError, EmptyMeshError
from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.color import bytes_from_unit, srgb_from_linear
from arm_blender.graphics.meshes import face_normals
from arm_blender.graphics.ragged import in_pieces
from arm_blender.graphics.raster.rasterize import Fragments, rasterize_views

from ..rendering import shards
from ..rendering.camera_rigs import random_views
from ..rendering.manifest import read_manifest
from . import surface as rasterized_surface
from .lights import Lighting, random_lighting, read_radiance
from .materials import Finish, random_finish
from .shading import SurfacePoints, VertexLight, light_vertices, shade
from .surface import Surface
from .textures import NOTHING, TextureSet, read_textures


@dataclass(frozen=True)
class Library:
    """What objects can be made of and lit by.

    Attributes:
        textures: texture sets; without any all materials are procedural.
        environments: (3, H, W) each, as of `read_radiance`; without any all light is made.
    """

    textures: Sequence[TextureSet]
    environments: Sequence[Tensor]


def read_library(data: Path | None) -> Library:
    """The texture sets and the environments of a data folder's training split.

    Args:
        data: with manifest.json; None for procedural materials and light alone.
    Raises:
        ArmError: a file cannot be read.
    """
    if data is None:
        return Library([], [])
    files = [data / e["files"][0] for e in read_manifest(data)["hdris"] if e["split"] == "train"]
    return Library(read_textures(data), [read_radiance(path) for path in files])


def random_rig(
    surface: Surface, library: Library, size: int, generator: torch.Generator, views: int = 10
) -> shards.Arrays:
    """One rig of a surface under random materials and light; the same generator gives the same rig.

    Args:
        size: pixels a side.
        views: the first six are inputs.
    Returns:
        the arrays of a `rig_<k>.npz`, and material (V, S, S) uint8: indices into `LABELS`, `NOTHING` where none is.
    """
    finish = random_finish(library.textures, generator)
    lighting = random_lighting(library.environments, generator)
    return rig_of(surface, random_views(size, generator)[:views], finish, lighting)


@torch.no_grad()
def rig_of(surface: Surface, views: Sequence[Camera], finish: Finish, lighting: Lighting) -> shards.Arrays:
    """The arrays of a rig: V views of one size of a surface."""
    size = views[0].height
    fragments = rasterize_views(surface.vertices, surface.faces, views)
    finer = rasterize_views(surface.vertices, surface.faces, [view.resized(2 * size, 2 * size) for view in views])
    alpha = functional.avg_pool2d(finer.mask[:, None].float(), 2)
    vertex_light = light_vertices(surface, lighting, finish)
    points, label, pixel = points_in_views(surface, views, finish, vertex_light, fragments)
    color = shade(points, surface, lighting, vertex_light.own)
    columns = torch.cat([color, points.values, points.normal], dim=1)  # (P, 11)
    flat = columns.new_zeros(len(views) * size * size, columns.shape[1]).index_copy_(0, pixel, columns)
    _bleed(flat, fragments.mask, (alpha[:, 0] > 0.0) & ~fragments.mask)
    lit, albedo, gloss, normal = flat.view(len(views), size, size, -1).split((3, 3, 2, 3), dim=3)
    material = torch.full((len(views) * size * size,), NOTHING, dtype=torch.uint8)
    material[pixel] = label.to(torch.uint8)
    rgb = bytes_from_unit(srgb_from_linear(lit))
    return {
        "rgba": torch.cat([rgb, bytes_from_unit(alpha[:, 0, ..., None])], dim=3).numpy(),
        "albedo": bytes_from_unit(srgb_from_linear(albedo)).numpy(),
        "roughness": bytes_from_unit(gloss[..., 0]).numpy(),
        "metallic": bytes_from_unit(gloss[..., 1]).numpy(),
        "depth": fragments.depth.half().numpy(),
        "normal": (functional.normalize(normal, dim=3) * 127.0).to(torch.int8).numpy(),
        "c2w": torch.stack([view.c2w for view in views]).numpy(),
        "K": torch.stack([view.K for view in views]).numpy(),
        "material": material.view(-1, size, size).numpy(),
    }


def points_in_views(
    surface: Surface,
    views: Sequence[Camera],
    finish: Finish,
    light: VertexLight,
    fragments: Fragments | None = None,
) -> tuple[SurfacePoints, Tensor, Tensor]:
    """Every pixel that shows the surface, the kind of its material (P,), and where it is in the flat pictures (P,).

    `fragments` are those of the views, found here where they are not given.
    """
    if fragments is None:
        fragments = rasterize_views(surface.vertices, surface.faces, views)
    pixel = fragments.mask.flatten().nonzero()[:, 0]
    face = fragments.face_id.flatten()[pixel]
    weights = fragments.barycentric.transpose(0, 1).flatten(1)[:, pixel].T  # (P, 3)
    place = torch.cat([surface.vertices, surface.normals], dim=1)
    flat, corner = face_normals(surface.vertices, surface.faces), surface.vertices[surface.faces[:, 0]]
    eye = torch.stack([view.center for view in views])[pixel // fragments.face_id[0].numel()]

    def mixed(face: Tensor, weights: Tensor, eye: Tensor) -> tuple[Tensor, ...]:
        corners = surface.faces[face]
        # As in Cycles both sides of a face are the outside. The face tells, for a smooth normal may tip at an outline.
        behind = (flat[face] * (eye - corner[face])).sum(dim=1, keepdim=True) < 0.0
        lit = corners + len(surface.vertices) * behind
        a, b, c = (
            weights[:, k, None]
            * torch.cat([place[corners[:, k]], light.irradiance[lit[:, k]], light.open[lit[:, k]]], 1)
            for k in range(3)
        )
        return a + b + c, behind

    found, behind = in_pieces(mixed, face, weights, eye)
    point, normal, irradiance, seen = found.split((3, 3, 3, 9), dim=1)
    normal = functional.normalize(normal, dim=1)
    values, label = finish(point, normal, surface.part[surface.faces[face, 0]])
    normal = torch.where(behind, -normal, normal)
    view = functional.normalize(eye - point, dim=1)
    return SurfacePoints(point, normal, view, irradiance, seen, values), label, pixel


def _bleed(flat: Tensor, mask: Tensor, wanted: Tensor) -> None:
    """Give pixels outside of a mask the mean of their neighbours inside it: outlines have a colour of their own.

    Args:
        flat: (V * S * S, C), changed in place.
        mask: (V, S, S) bool. wanted: (V, S, S) bool, outside of the mask.
    """
    view, row, column = wanted.nonzero(as_tuple=True)
    size = mask.shape[-1]
    total, count = flat.new_zeros(len(view), flat.shape[1]), flat.new_zeros(len(view), 1)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            y, x = (row + down).clamp(0, size - 1), (column + right).clamp(0, size - 1)
            inside = mask[view, y, x, None].float()
            total += inside * flat[(view * size + y) * size + x]
            count += inside
    flat[(view * size + row) * size + column] = total / count.clamp(min=1.0)


def surface_at(mesh: Path, cache: Path) -> Surface:
    """The surface of a `mesh.npz`, made ready where it is not kept in a folder yet.

    Raises:
        ArmError: nothing is left of the mesh.
    """
    kept = cache / f"{mesh.parent.name}.surface.npz"
    if kept.exists():
        return rasterized_surface.load(kept)
    try:
        surface = rasterized_surface.surface_of(shards.read_mesh(mesh))
    except EmptyMeshError as error:
        raise ArmError(f"{mesh}: {error}") from error
    rasterized_surface.save(kept, surface)
    return surface
