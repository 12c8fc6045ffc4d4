"""A user's mesh, from a file or from Blender: it keeps its shape, and its UVs if they are an atlas."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import EmptyMeshError
from ..structures import TriangleMesh, UvMesh

LARGEST = 1e6
"""World units: beyond it the squares and products of float32 coordinates say nothing about a box of 2."""

_SMALLEST_ATLAS = 1e-4
"""Of the unit square, how much an atlas has to fill: less is a hundred texels of 1024 x 1024."""


def mesh_from_arrays(
    name: str,
    vertices: NDArray[Any],
    faces: NDArray[Any],
    uvs: tuple[NDArray[Any], NDArray[Any]] | None = None,
    charts: int = 1,
) -> TriangleMesh | UvMesh:
    """A welded mesh of the program's, from the arrays of another.

    Args:
        name: of the mesh, for messages.
        vertices: (N, 3) in the cameras' frame, Z up.
        faces: (F, 3) indices into `vertices`.
        uvs: (M, 2) v up, and (F, 3) indices into them; None where the mesh has none.
        charts: of those UVs.
    Returns:
        A `UvMesh` where the UVs lie inside [0, 1] and fill some area, else a `TriangleMesh`. Faces that lie in a point
        or a line by their indices are gone.
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
    if not sound.any():
        raise EmptyMeshError(f"{name}: every triangle is degenerate; give a mesh with faces")
    shape = torch.from_numpy(np.ascontiguousarray(unique)), torch.from_numpy(np.ascontiguousarray(welded[sound]))
    if uvs is None or not _is_atlas(*uvs):
        return TriangleMesh(*shape)
    uv, face_uvs = np.asarray(uvs[0], np.float32), np.asarray(uvs[1], np.int64)
    return UvMesh(*shape, torch.from_numpy(uv), torch.from_numpy(face_uvs[sound]), charts)


def _is_atlas(uv: NDArray[Any], face_uvs: NDArray[Any]) -> bool:
    """Tiled UVs are none: several points would share a texel. Nor are those in one place, as some exporters write."""
    if not np.isfinite(uv).all() or uv.min() < 0.0 or uv.max() > 1.0:
        return False
    a, b, c = np.moveaxis(uv[face_uvs], 1, 0)
    areas = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2.0
    return bool(areas.sum() >= _SMALLEST_ATLAS)
