"""Tangents of a textured mesh, as MikkTSpace defines them and Blender, glTF and game engines take them.

M. Mikkelsen, "Simulation of Wrinkled Surfaces Revisited" (2008), and its reference for triangles: the direction of
growing u in each face, laid into the plane of each corner's normal, averaged by angle over the faces that share the
corner's position, normal and UV, and whose UVs turn the same way round.
"""

import torch
from torch import Tensor

from ..structures import UvMesh
from .meshes import MIN_LENGTH, angle_between, signed_areas


def corner_tangents(mesh: UvMesh, normals: Tensor) -> tuple[Tensor, Tensor]:
    """The tangent at each corner of each face.

    Args:
        mesh: with its atlas.
        normals: (N, 3) unit, of its vertices.
    Returns:
        (F, 3, 3) unit vectors, orthogonal to the normals; 0 where the UVs have no direction. (F,) 1 or -1: the
        bitangent, along growing v, is that times normal x tangent; -1 where the UVs are mirrored.
    Raises:
        ValueError: not one normal a vertex.
    """
    if normals.shape != mesh.vertices.shape:
        raise ValueError(f"normals {tuple(mesh.vertices.shape)} expected, got {tuple(normals.shape)}")
    area = signed_areas(mesh.uvs, mesh.face_uvs)
    turn = torch.where(area >= 0.0, 1.0, -1.0).to(mesh.vertices.dtype)
    a, b, c = mesh.vertices[mesh.faces].unbind(dim=1)
    va, vb, vc = mesh.uvs[mesh.face_uvs][..., 1].unbind(dim=1)
    along_u = turn[:, None] * ((vc - va)[:, None] * (b - a) - (vb - va)[:, None] * (c - a))  # (F, 3)
    at = normals[mesh.faces]  # (F, 3 corners, 3)
    flat = _flattened(along_u[:, None].expand_as(at), at)
    corners = mesh.vertices[mesh.faces]
    ahead = _flattened(corners.roll(-1, dims=1) - corners, at)
    behind = _flattened(corners.roll(1, dims=1) - corners, at)
    weight = angle_between(ahead, behind) * (area != 0.0)[:, None]
    keys = torch.stack([
        mesh.faces.flatten(), mesh.face_uvs.flatten(), (turn > 0.0).long().repeat_interleave(3)
    ], dim=1)  # fmt: skip
    distinct, group = torch.unique(keys, dim=0, return_inverse=True)
    total = flat.new_zeros(len(distinct), 3).index_add(0, group, (weight[..., None] * flat).reshape(-1, 3))
    return _unit(total)[group].view_as(flat), turn


def _flattened(vectors: Tensor, normals: Tensor) -> Tensor:
    """Unit vectors: (..., 3) laid into the planes of unit `normals` (..., 3); 0 where nothing is left."""
    flat = vectors - (normals * vectors).sum(dim=-1, keepdim=True) * normals
    return _unit(flat)


def _unit(vectors: Tensor) -> Tensor:
    length = vectors.norm(dim=-1, keepdim=True)
    return torch.where(length > MIN_LENGTH, vectors / length.clamp(min=MIN_LENGTH), 0.0)
