"""A user's mesh, from a file or from Blender: it keeps its shape, and its UVs if they are an atlas."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import EmptyMeshError
from ..structures import TriangleMesh, UvMesh
from .given.own_uvs import own_uvs

LARGEST = 1e6
"""World units: beyond it the squares and products of float32 coordinates say nothing about a box of 2."""

_THIN = 1e-6
"""Height of a face over its longest side, from which on it is more than a line: what float32 can tell apart."""

LeaveOut = Callable[[str, str], None]
"""Is told what is not used, and why; `Report.leave_out` is one."""


def unheard(what: str, why: str) -> None:
    """The `LeaveOut` that tells nobody."""


def mesh_from_arrays(
    name: str,
    vertices: NDArray[Any],
    faces: NDArray[Any],
    uvs: tuple[NDArray[Any], NDArray[Any]] | None = None,
    charts: int = 1,
    left_out: LeaveOut = unheard,
) -> TriangleMesh | UvMesh:
    """A welded mesh of the program's, from the arrays of another.

    Args:
        name: of the mesh, for messages.
        vertices: (N, 3) in the cameras' frame, Z up.
        faces: (F, 3) indices into `vertices`.
        uvs: (M, 2) v up, and (F, 3) indices into them; None where the mesh has none.
        charts: of those UVs.
        left_out: is told where the UVs are not used, or not as they are.
    Returns:
        A `UvMesh` where the UVs are an atlas (`own_uvs`), else a `TriangleMesh`. Faces that lie in a point or a line
        are gone.
    Raises:
        EmptyMeshError: without triangles, or with coordinates that are not finite or lie beyond `LARGEST`.
    """
    vertices = np.asarray(vertices, np.float32)
    if not (np.abs(vertices) <= LARGEST).all():
        raise EmptyMeshError(f"{name}: has coordinates beyond {LARGEST:g}; bring it to where the cameras look")
    # Files split vertices at seams; welded by position, the mesh does not tear.
    unique, inverse = np.unique(vertices, axis=0, return_inverse=True)
    welded = inverse.reshape(-1)[np.asarray(faces, np.int64)]
    sound = (welded[:, 0] != welded[:, 1]) & (welded[:, 1] != welded[:, 2]) & (welded[:, 2] != welded[:, 0])
    faces = np.ascontiguousarray(welded[sound])
    if not _has_area(unique, faces):
        raise EmptyMeshError(f"{name}: every triangle is degenerate, a point or a line; give a mesh with faces")
    shape = torch.from_numpy(np.ascontiguousarray(unique)), torch.from_numpy(faces)
    if uvs is None:
        return TriangleMesh(*shape)
    found = own_uvs(unique, faces, uvs[0], np.asarray(uvs[1], np.int64)[sound])
    if isinstance(found, str):
        left_out("the UVs of the mesh", f"{found}; it is unwrapped anew")
        return TriangleMesh(*shape)
    if found.moved:
        left_out("the place of the mesh's UVs", f"they were {found.moved}; their layout stays")
    return UvMesh(*shape, torch.from_numpy(found.uvs), torch.from_numpy(found.face_uvs), charts)


def _has_area(vertices: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Whether any face is more than a line, beside how large it is."""
    a, b, c = np.moveaxis(vertices.astype(np.float64)[faces], 1, 0)
    longest = np.linalg.norm([b - a, c - b, a - c], axis=-1).max(axis=0)
    return bool((np.linalg.norm(np.cross(b - a, c - a), axis=-1) > _THIN * longest**2).any())
