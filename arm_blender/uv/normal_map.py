"""The detail that decimation took, as a tangent-space normal map for the decimated mesh."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from ..graphics.meshes import angle_weighted_normals
from ..graphics.raster.rasterize import Fragments, interpolate, rasterize_uv
from ..graphics.raster.rays import MISS, nearest_hits
from ..graphics.tangents import corner_tangents
from ..report import Report
from ..structures import MaterialMaps, TriangleMesh, UvMesh
from .maps import pad

DETAIL_TEXELS = 512
"""Texels a side of the normal map at most: twice as many take four times as long, and gain little
(docs/normal-map.md)."""

FLAT = (0.0, 0.0, 1.0)
"""What changes nothing."""


@dataclass(frozen=True)
class NormalMapConfig:
    """How the detail is found."""

    reaches: tuple[float, ...] = (0.25, 2.0)
    """How far from the decimated surface to look for the dense one, in edges of its triangles: first the least, which
    is fast and finds nearly all. A small last one misses it where much was taken away; a large one finds far walls."""
    steepest: float = 0.1
    """Least share of a normal along that of the mesh; below it the dense surface turns away, and no map can say so."""


def detail(mesh: UvMesh, dense: TriangleMesh | None, material: MaterialMaps, report: Report) -> MaterialMaps:
    """The material with the normals of the mesh as it was before decimation, None where no face was taken from it."""
    if dense is None:
        report.leave_out("normal map", "no face was taken from the mesh")
        return material
    size = min(material.albedo.shape[-1], DETAIL_TEXELS)
    normal, share = bake_normal_map(mesh, dense, size)
    if share < 1.0:
        report.leave_out("a part of the normal map", f"{1.0 - share:.2%} of the texels lie off the dense surface")
    return replace(material, normal=normal)


@torch.no_grad()
def bake_normal_map(
    mesh: UvMesh, dense: TriangleMesh, size: int, config: NormalMapConfig = NormalMapConfig()
) -> tuple[Tensor, float]:
    """The normals of `dense` in the tangent space of `mesh`.

    The space is that of Blender, glTF and MikkTSpace: interpolated normal and tangent as they are, not normalised, and
    the bitangent their cross product (Mikkelsen 2008). A renderer that does the same gets the dense normals back.

    Args:
        mesh: decimated, with its atlas.
        dense: what it was decimated from, in the same place.
        size: texels a side.
    Returns:
        (3, T, T) unit vectors, z along the mesh's own normal; gaps are padded, and what finds no dense surface is
        `FLAT`. The share of covered texels that found it, in [0, 1].
    """
    fragments = rasterize_uv(mesh.uvs, mesh.face_uvs, size)
    covered = fragments.mask
    own = angle_weighted_normals(mesh.vertices, mesh.faces)
    position = interpolate(mesh.vertices, mesh.faces, fragments)[:, covered].T
    normal = interpolate(own, mesh.faces, fragments)[:, covered].T
    edges = dense.vertices[dense.faces[:, 1]] - dense.vertices[dense.faces[:, 0]]
    face = torch.full((len(position),), MISS, dtype=torch.int64, device=position.device)
    where = torch.zeros_like(position)
    for reach in config.reaches:
        left = (face == MISS).nonzero()[:, 0]
        distance = reach * float(edges.norm(dim=1).mean())
        face[left], where[left] = nearest_hits(
            position[left], functional.normalize(normal[left]), dense.vertices, dense.faces, distance
        )
    found = face != MISS
    smooth = angle_weighted_normals(dense.vertices, dense.faces)[dense.faces[face[found]]]
    target = functional.normalize((where[found, :, None] * smooth).sum(dim=1))
    tangent, bitangent = tangent_frame(mesh, own, fragments, normal)
    texels = position.new_tensor(FLAT).expand(len(position), 3).clone()
    texels[found] = _in_frame(target, tangent[found], bitangent[found], normal[found], config.steepest)
    image = position.new_zeros(3, size, size)
    image[:, covered] = texels.T
    share = float(found.float().mean()) if len(found) else 0.0
    image = pad(image, covered)
    return torch.where(image.norm(dim=0) > 0.0, image, image.new_tensor(FLAT)[:, None, None]), share


def unit_from_normals(normals: Tensor) -> Tensor:
    """(3, T, T) in [0, 1], as the bytes of a picture hold them: red along the tangent, green along growing v."""
    return 0.5 + 0.5 * normals


def tangent_frame(mesh: UvMesh, normals: Tensor, fragments: Fragments, normal: Tensor) -> tuple[Tensor, Tensor]:
    """(P, 3) tangents and bitangents where a face is, as long as they come out of the interpolation.

    Args:
        normals: (N, 3) unit, of the vertices.
        fragments: of the mesh, in its atlas or before a camera.
        normal: (P, 3) `normals`, interpolated.
    """
    tangents, turn = corner_tangents(mesh, normals)
    corners = torch.arange(3 * len(mesh.faces), device=tangents.device).view(-1, 3)
    tangent = interpolate(tangents.reshape(-1, 3), corners, fragments)[:, fragments.mask].T
    sign = turn[fragments.face_id[fragments.mask]]
    return tangent, sign[:, None] * torch.linalg.cross(normal, tangent, dim=1)


def _in_frame(target: Tensor, tangent: Tensor, bitangent: Tensor, normal: Tensor, steepest: float) -> Tensor:
    """(P, 3) unit: the factors of the three axes that add up to `target` (P, 3), but for its length."""
    across, along, up = (
        (target * torch.linalg.cross(first, second, dim=1)).sum(dim=1)
        for first, second in ((bitangent, normal), (normal, tangent), (tangent, bitangent))
    )
    volume = (tangent * torch.linalg.cross(bitangent, normal, dim=1)).sum(dim=1)
    factors = functional.normalize(torch.stack([across, along, up], dim=1) * volume.sign()[:, None])
    good = (factors[:, 2] > steepest) & (volume.abs() > 1e-6)
    return torch.where(good[:, None], factors, factors.new_tensor(FLAT))
