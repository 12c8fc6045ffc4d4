"""A mesh of the user's: its own shape, and its own UVs if it has them."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from ..errors import EmptyMeshError
from ..structures import TriangleMesh, UvMesh
from .given.gltf_file import shapes_of
from .given.obj_file import triangles_of_obj
from .given.ply_file import arrays_of_ply
from .given_mesh import LeaveOut, mesh_from_arrays, unheard

Y_UP = {".glb", ".gltf"}
"""Formats whose up axis is Y by specification; of all others only the views can tell (`views.mesh_fit.up_axis`)."""

Part = tuple[NDArray[Any], NDArray[Any], NDArray[Any] | None]
"""(N, 3) vertices, (F, 3) faces, and (F, 3, 2) UVs of their corners or None."""


def read_mesh(path: Path, left_out: LeaveOut = unheard) -> TriangleMesh | UvMesh:
    """Read any mesh that trimesh reads, polygons as well; all parts become one, in the cameras' frame (Z up).

    Args:
        path: of the file.
        left_out: is told where UVs are not used, or not as they are.
    Returns:
        A `UvMesh` where every part has UVs that are an atlas, else a `TriangleMesh` (`mesh_from_arrays`).
    Raises:
        EmptyMeshError: no such file, unreadable, or as `mesh_from_arrays`.
    """
    if not path.is_file():
        raise EmptyMeshError(f"{path}: no such file; give a GLB, OBJ, PLY or STL")
    try:
        parts = [(_checked(*part)) for part in _parts(path) if len(part[1])]
        # trimesh's readers, and ours, raise whatever a damaged file makes them stumble over.
    except Exception as error:  # noqa: BLE001
        reason = str(error) or type(error).__name__
        raise EmptyMeshError(f"{path}: cannot be read as a mesh ({reason}); give a GLB, OBJ, PLY or STL") from error
    if not parts:
        raise EmptyMeshError(f"{path}: holds no triangles; give a mesh with faces")
    offsets = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts[:-1])])
    vertices = np.concatenate([part[0] for part in parts])
    faces = np.concatenate([part[1] + offset for part, offset in zip(parts, offsets, strict=True)])
    if path.suffix.lower() in Y_UP:
        vertices = vertices[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0], np.float32)
    uvs = [uv for _, _, uv in parts if uv is not None]
    corners = None
    if len(uvs) == len(parts):
        corners = np.concatenate(uvs).reshape(-1, 2), np.arange(3 * len(faces)).reshape(-1, 3)
    elif uvs:
        left_out(
            "the UVs of the mesh", f"{len(parts) - len(uvs)} of its {len(parts)} parts have none; it is unwrapped anew"
        )
    return mesh_from_arrays(str(path), vertices, faces, corners, len(parts), left_out)


def _parts(path: Path) -> list[Part]:
    """The parts of a file, wherever they are placed."""
    kind = path.suffix.lower().removeprefix(".")
    if kind == "ply":
        return [arrays_of_ply(path)]
    if f".{kind}" in Y_UP:
        scene = trimesh.load_scene(BytesIO(shapes_of(path)), file_type="glb", process=False)
    elif kind == "obj":
        scene = trimesh.load_scene(BytesIO(triangles_of_obj(path)), file_type="obj", process=False, skip_materials=True)
    else:
        scene = trimesh.load_scene(path)
    found = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    return [(part.vertices, np.asarray(part.faces, np.int64), _uv(part)) for part in found]


def _checked(vertices: NDArray[Any], faces: NDArray[Any], uv: NDArray[Any] | None) -> Part:
    """A part whose faces have vertices of three numbers.

    Raises:
        ValueError: they have not.
    """
    vertices = np.asarray(vertices, np.float32)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"vertices {vertices.shape}, faces {faces.shape}")
    if not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
        raise ValueError(f"a face has vertex {int(faces.max())} of {len(vertices)}")
    return vertices, faces, uv


def _uv(part: trimesh.Trimesh) -> NDArray[Any] | None:
    """(F, 3, 2) of its faces' corners; None where it has none."""
    uv = getattr(part.visual, "uv", None)
    if uv is None or len(uv) != len(part.vertices) or np.ndim(uv) != 2 or np.shape(uv)[1] < 2:
        return None
    return np.asarray(uv)[:, :2][part.faces]
