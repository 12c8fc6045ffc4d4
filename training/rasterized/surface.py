"""Surfaces that are lit without ray tracing: smooth where they are, and knowing what each vertex sees of the sky.

Which directions are hidden from a vertex depends on the shape alone. It is found once for an object, by one z-buffer a
direction, kept as bits, and serves every light: shadows of the environment, ambient occlusion, hidden reflections.
"""

import functools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from arm_blender.graphics.cameras import Camera, look_at, project
from arm_blender.graphics.connectivity import face_components
from arm_blender.graphics.meshes import corner_angles, face_areas, face_normals
from arm_blender.graphics.ragged import enumerate_items
from arm_blender.graphics.raster.rasterize import rasterize_views
from arm_blender.structures import TriangleMesh
from arm_blender.uv.decimate import clean, decimate

from ..rendering.shards import save_arrays

DIRECTIONS = 128
"""Of the sky; one stands for a cone of about 10° around it."""
FAR, BUFFER, BIAS = 60.0, 256, 0.015
"""Of the z-buffers: distance of the light and depth tolerance in world units, pixels a side. The object fits a ball of
radius 1.8."""


@dataclass(frozen=True)
class CutConfig:
    """How finely a surface is cut."""

    faces: int = 8_000
    """Budget; a larger mesh is decimated. More costs time in every picture."""
    longest: float = 0.12
    """World units. Longer edges are cut in halves, or light and shadow could not change along a wall."""
    sharp_deg: float = 40.0
    """Faces that meet at a larger angle have an edge between them."""


@dataclass(frozen=True)
class Surface:
    """A mesh whose vertices are split at sharp edges.

    Attributes:
        vertices: (N, 3) world, inside [-1, 1]^3.
        normals: (N, 3) unit.
        faces: (F, 3) int64.
        part: (N,) int64: the connected part of the object that a vertex belongs to.
        visible: (2 * N, D) bool: what the mesh lets reach each vertex from each of `directions()` in front, and then,
            as many shapes are sheets, behind.
    """

    vertices: Tensor
    normals: Tensor
    faces: Tensor
    part: Tensor
    visible: Tensor


@functools.cache
def directions() -> Tensor:
    """(D, 3) unit: a Fibonacci lattice, each point of which stands for the same solid angle."""
    index = torch.arange(DIRECTIONS, dtype=torch.float64)
    z = 1.0 - 2.0 * (index + 0.5) / DIRECTIONS
    turn, across = math.pi * (1.0 + 5.0**0.5) * index, (1.0 - z * z).sqrt()
    return torch.stack([across * turn.cos(), across * turn.sin(), z], dim=1).float()


def welded(mesh: TriangleMesh) -> TriangleMesh:
    """Vertices at one place become one. Files split them where normals or texture coordinates do."""
    _, index = torch.unique((mesh.vertices * 1e5).round().long(), dim=0, return_inverse=True)
    vertices = torch.empty(int(index.max()) + 1, 3).index_copy_(0, index, mesh.vertices)
    return TriangleMesh(vertices, index[mesh.faces])


@torch.no_grad()
def surface_of(mesh: TriangleMesh, config: CutConfig = CutConfig()) -> Surface:
    """A mesh made ready to be lit; about two seconds.

    Raises:
        EmptyMeshError: nothing is left of it.
    """
    whole = clean(welded(mesh), min_part=1e-3)
    if len(whole.faces) > config.faces:
        whole = decimate(whole, config.faces)
    vertices, faces = refined(whole.vertices, whole.faces, config.longest, 2 * config.faces)
    part = torch.zeros(len(vertices), dtype=torch.int64)
    part[faces] = face_components(faces)[:, None]
    origin, normals, faces = split_at_edges(vertices, faces, config.sharp_deg)
    vertices = vertices[origin]
    return Surface(vertices, normals, faces, part[origin], visibility(vertices, normals, faces))


def refined(vertices: Tensor, faces: Tensor, longest: float, most: int) -> tuple[Tensor, Tensor]:
    """The same surface with edges over `longest` cut in halves, while there are fewer than about `most` faces."""
    # Bisecting the longest edges ends at triangles of about a sixth of that length squared.
    longest = max(longest, float(6.0 * face_areas(vertices, faces).sum() / most) ** 0.5)
    while True:
        corners = vertices[faces]
        length, edge = (corners.roll(-1, dims=1) - corners).norm(dim=2).max(dim=1)
        long = length > longest
        if not bool(long.any()) or len(faces) + int(long.sum()) > 2 * most:
            return vertices, faces
        a, b, c = (faces[long, (edge[long] + k) % 3] for k in range(3))
        pairs = torch.stack([torch.minimum(a, b), torch.maximum(a, b)], dim=1)
        pairs, index = torch.unique(pairs, dim=0, return_inverse=True)
        middle = len(vertices) + index
        vertices = torch.cat([vertices, vertices[pairs].mean(dim=1)])
        faces = torch.cat([faces[~long], torch.stack([a, middle, c], 1), torch.stack([middle, b, c], 1)])


def split_at_edges(vertices: Tensor, faces: Tensor, sharp_deg: float) -> tuple[Tensor, Tensor, Tensor]:
    """Smooth normals that stop at sharp edges.

    Returns:
        (M,) int64 vertex that each new one was split from, (M, 3) unit normals, (F, 3) faces of the new vertices.
    """
    flat, corner = face_normals(vertices, faces), faces.flatten()
    weighted = corner_angles(vertices, faces).flatten()[:, None] * flat.repeat_interleave(3, dim=0)
    count = torch.bincount(corner, minlength=len(vertices))
    start, order = torch.cumsum(count, dim=0) - count, torch.argsort(corner, stable=True)
    # Each corner with all that share its vertex.
    owner, number = enumerate_items(count[corner])
    other = order[start[corner[owner]] + number]
    smooth = (flat[owner // 3] * flat[other // 3]).sum(dim=1) > math.cos(math.radians(sharp_deg))
    normals = torch.zeros(len(corner), 3).index_add_(0, owner[smooth], weighted[other[smooth]])
    normals = functional.normalize(normals, dim=1)
    key = torch.cat([corner[:, None], (normals * 64.0).round().long()], dim=1)
    distinct, index = torch.unique(key, dim=0, return_inverse=True)
    # Rounded normals tell vertices apart; those kept are exact.
    kept = torch.empty(len(distinct), 3).index_copy_(0, index, normals)
    return distinct[:, 0], kept, index.view(-1, 3)


def sky_camera(direction: Tensor) -> Camera:
    """A camera in the direction of a distant light (3,), that sees all of the object as that light does."""
    focal = BUFFER / 2.0 * FAR / 1.8
    K = torch.tensor([[focal, 0.0, BUFFER / 2.0], [0.0, focal, BUFFER / 2.0], [0.0, 0.0, 1.0]])
    return Camera(look_at(FAR * direction), K, BUFFER, BUFFER)


def unshadowed(points: Tensor, normals: Tensor, depth: Tensor, camera: Camera) -> Tensor:
    """(P,) bool: points (P, 3) that a light reaches, by its z-buffer (BUFFER, BUFFER) of `sky_camera`."""
    where, away = project(points + BIAS * normals, camera)
    column, row = where.long().clamp(0, BUFFER - 1).unbind(dim=1)
    return away <= depth[row, column] + BIAS


def visibility(vertices: Tensor, normals: Tensor, faces: Tensor) -> Tensor:
    """(2 * N, D) bool: whether the mesh lets each of `directions()` reach each vertex in front, and each behind."""
    points, lift = vertices.repeat(2, 1), torch.cat([normals, -normals])
    found = torch.empty(DIRECTIONS, len(points), dtype=torch.bool)
    for group in torch.arange(DIRECTIONS).split(16):
        cameras = [sky_camera(directions()[k]) for k in group.tolist()]
        depth = rasterize_views(vertices, faces, cameras).depth
        for k, buffer, camera in zip(group.tolist(), depth, cameras, strict=True):
            found[k] = unshadowed(points, lift, buffer, camera)
    return found.T.contiguous()


def save(path: Path, surface: Surface) -> None:
    """Keep a surface for the next time.

    Raises:
        OutputError: the file cannot be written.
    """
    arrays = {
        "vertices": surface.vertices.numpy(),
        "normals": surface.normals.numpy(),
        "faces": surface.faces.int().numpy(),
        "part": surface.part.int().numpy(),
        "visible": np.packbits(surface.visible.numpy(), axis=1),
    }
    save_arrays(path, arrays)


def load(path: Path) -> Surface:
    """What `save` kept."""
    with np.load(path) as file:
        bits = np.unpackbits(file["visible"], axis=1, count=DIRECTIONS).astype(bool)
        vertices, normals, faces, part = (torch.from_numpy(file[n]) for n in ("vertices", "normals", "faces", "part"))
    return Surface(vertices, normals, faces.long(), part.long(), torch.from_numpy(bits))
