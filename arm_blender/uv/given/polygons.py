"""Polygons of any shape as triangles that cover them, and nothing else."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_CORNERS = 2000
"""Of one polygon: cutting off ears takes the square of it."""


def triangulated(vertices: NDArray[Any], polygons: Sequence[Sequence[int]]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Triangles of polygons, wound as they are: a fan where one is convex, else by cutting off ears.

    A corner is an ear that turns as the polygon does and whose triangle holds no other corner (Meisters, "Polygons have
    ears", 1975).

    Args:
        vertices: (N, 3).
        polygons: of each the numbers of its corners' vertices, in their order; about in a plane, simple. Those of fewer
            than three corners have no triangle.
    Returns:
        (T,) int64 which polygon each triangle is of, ascending; and (T, 3) int64 which corners of it.
    Raises:
        ValueError: one has more than `MOST_CORNERS` corners.
        IndexError: a corner has no vertex.
    """
    sizes = np.array([len(polygon) for polygon in polygons], np.int64)
    owners, triangles = [np.zeros(0, np.int64)], [np.zeros((0, 3), np.int64)]
    for size in np.unique(sizes[sizes >= 3]):
        if size > MOST_CORNERS:
            raise ValueError(f"a polygon has {size} corners; triangulate the mesh first")
        members = (sizes == size).nonzero()[0]
        fan = np.stack([np.zeros(size - 2, np.int64), np.arange(1, size - 1), np.arange(2, size)], axis=1)
        flat = _in_plane(np.asarray(vertices, np.float64)[np.array([polygons[index] for index in members])])
        concave = (_turns(flat) < 0.0).any(axis=1)
        owners.append(members[~concave].repeat(size - 2))
        triangles.append(np.tile(fan, (int((~concave).sum()), 1)))
        for index, corners in zip(members[concave], flat[concave], strict=True):
            owners.append(np.full(size - 2, index))
            triangles.append(_without_ears(corners))
    owner = np.concatenate(owners)
    order = owner.argsort(kind="stable")
    return owner[order], np.concatenate(triangles)[order]


def _without_ears(flat: NDArray[Any]) -> NDArray[Any]:
    """(n - 2, 3) triangles of a polygon (n, 2), counter-clockwise."""
    left, found = list(range(len(flat))), []
    while len(left) > 3:
        ear = _ear(flat, np.array(left))
        found.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    return np.array([*found, left])


def _in_plane(corners: NDArray[Any]) -> NDArray[Any]:
    """(P, n, 2) polygons (P, n, 3) in the planes of Newell's normals, counter-clockwise."""
    centered = corners - corners.mean(axis=1, keepdims=True)
    normal = np.cross(centered, np.roll(centered, -1, axis=1)).sum(axis=1)
    axis = np.abs(normal).argmax(axis=1)
    # Along the axis that the normal is nearest to nothing folds over, and turns keep their sense.
    first, second = (np.take_along_axis(centered, ((axis + k) % 3)[:, None, None], 2)[..., 0] for k in (1, 2))
    upright = np.take_along_axis(normal, axis[:, None], 1) >= 0.0
    return np.stack([first, np.where(upright, second, -second)], axis=-1)


def _turns(flat: NDArray[Any]) -> NDArray[Any]:
    """(..., n) twice the area to the left at each corner of polygons (..., n, 2)."""
    return _cross(flat - np.roll(flat, 1, axis=-2), np.roll(flat, -1, axis=-2) - flat)


def _ear(flat: NDArray[Any], order: NDArray[Any]) -> int:
    """The place in `order` of a corner to cut off: an ear, else whatever turns most (of polygons that cross)."""
    turns = _turns(flat[order])
    before, after = np.roll(order, 1), np.roll(order, -1)
    for place in np.argsort(-turns, kind="stable"):
        if turns[place] <= 0.0:
            break
        a, b, c = flat[before[place]], flat[order[place]], flat[after[place]]
        others = flat[order[~np.isin(order, (before[place], order[place], after[place]))]]
        others = others[~((others == a).all(axis=1) | (others == c).all(axis=1))]
        inside = [_cross(second - first, others - first) >= 0.0 for first, second in ((a, b), (b, c), (c, a))]
        if not np.logical_and.reduce(inside).any():
            return int(place)
    return int(turns.argmax())


def _cross(first: NDArray[Any], second: NDArray[Any]) -> NDArray[Any]:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
