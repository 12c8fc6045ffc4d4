"""A mesh of the user's: its own shape, and its own UVs if it has them."""

from pathlib import Path

import numpy as np
import torch
import trimesh

from ..errors import EmptyMeshError
from ..structures import TriangleMesh, UvMesh

Y_UP = {".glb", ".gltf"}
"""Formats whose up axis is Y by specification; all others are taken as they are."""


LARGEST = 1e6
"""World units: beyond it the squares and products of float32 coordinates say nothing about a box of 2."""

_SMALLEST_ATLAS = 1e-4
"""Of the unit square, how much an atlas has to fill: less is a hundred texels of 1024 x 1024."""


def read_mesh(path: Path) -> TriangleMesh | UvMesh:
    """Read any mesh that trimesh reads; all parts become one, in the cameras' frame (Z up).

    Returns:
        A `UvMesh` where every part has UVs inside [0, 1] that fill some area, else a `TriangleMesh`.
    Raises:
        EmptyMeshError: no such file, unreadable, without triangles, or with coordinates beyond `LARGEST`.
    """
    try:
        scene = trimesh.load_scene(path)
        # trimesh's readers raise whatever their formats make them stumble over.
    except Exception as error:  # noqa: BLE001
        raise EmptyMeshError(f"{path}: cannot be read as a mesh ({error}); give a GLB, OBJ, PLY or STL") from error
    parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if not parts:
        raise EmptyMeshError(f"{path}: holds no triangles; give a mesh with faces")
    uvs = [getattr(part.visual, "uv", None) for part in parts]
    mesh = trimesh.util.concatenate([trimesh.Trimesh(p.vertices, p.faces, process=False) for p in parts])
    vertices = np.asarray(mesh.vertices, np.float32)
    if path.suffix.lower() in Y_UP:
        vertices = vertices[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0], np.float32)
    if not (np.abs(vertices) <= LARGEST).all():
        raise EmptyMeshError(f"{path}: has coordinates beyond {LARGEST:g}; bring it to where the cameras look")
    # Files split vertices at seams; welded by position, the mesh does not tear.
    unique, inverse = np.unique(vertices, axis=0, return_inverse=True)
    split = np.asarray(mesh.faces, np.int64)
    faces = inverse.reshape(-1)[split]
    sound = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    welded = torch.from_numpy(np.ascontiguousarray(unique)), torch.from_numpy(np.ascontiguousarray(faces[sound]))
    if not sound.any():
        raise EmptyMeshError(f"{path}: every triangle is degenerate; give a mesh with faces")
    if any(uv is None or len(uv) != len(part.vertices) for uv, part in zip(uvs, parts, strict=True)):
        return TriangleMesh(*welded)
    uv = np.concatenate(uvs).astype(np.float32)
    if not np.isfinite(uv).all() or uv.min() < 0.0 or uv.max() > 1.0:
        return TriangleMesh(*welded)  # Tiled UVs are no atlas: several points would share a texel.
    a, b, c = np.moveaxis(uv[split], 1, 0)
    areas = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2.0
    if areas.sum() < _SMALLEST_ATLAS:
        return TriangleMesh(*welded)  # All in one place, as some exporters write for "none".
    return UvMesh(*welded, torch.from_numpy(uv), torch.from_numpy(split[sound]), charts=len(parts))
