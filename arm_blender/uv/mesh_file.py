"""A mesh of the user's: its own shape, and its own UVs if it has them."""

from pathlib import Path

import numpy as np
import trimesh

from ..errors import EmptyMeshError
from ..structures import TriangleMesh, UvMesh
from .given_mesh import mesh_from_arrays

Y_UP = {".glb", ".gltf"}
"""Formats whose up axis is Y by specification; all others are taken as they are."""


def read_mesh(path: Path) -> TriangleMesh | UvMesh:
    """Read any mesh that trimesh reads; all parts become one, in the cameras' frame (Z up).

    Returns:
        A `UvMesh` where every part has UVs that are an atlas, else a `TriangleMesh` (`mesh_from_arrays`).
    Raises:
        EmptyMeshError: no such file, unreadable, or as `mesh_from_arrays`.
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
    corner_uvs = None
    if all(uv is not None and len(uv) == len(part.vertices) for uv, part in zip(uvs, parts, strict=True)):
        corner_uvs = np.concatenate(uvs), np.asarray(mesh.faces)
    return mesh_from_arrays(str(path), vertices, np.asarray(mesh.faces), corner_uvs, charts=len(parts))
