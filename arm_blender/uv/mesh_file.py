"""A mesh of the user's: its own shape, and its own UVs if it has them."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

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
    uvs = [uv for part in parts if (uv := _uv(part)) is not None]
    mesh = trimesh.util.concatenate([trimesh.Trimesh(p.vertices, p.faces, process=False) for p in parts])
    assert isinstance(mesh, trimesh.Trimesh)  # As its parts are.
    vertices = np.asarray(mesh.vertices, np.float32)
    if path.suffix.lower() in Y_UP:
        vertices = vertices[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0], np.float32)
    corner_uvs = None
    if len(uvs) == len(parts):
        corner_uvs = np.concatenate(uvs), np.asarray(mesh.faces)
    return mesh_from_arrays(str(path), vertices, np.asarray(mesh.faces), corner_uvs, charts=len(parts))


def _uv(part: trimesh.Trimesh) -> NDArray[Any] | None:
    """(N, 2) of its N vertices; None where it has none."""
    uv = getattr(part.visual, "uv", None)
    return None if uv is None or len(uv) != len(part.vertices) else uv
