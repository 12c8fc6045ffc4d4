"""Polygons of any shape become triangles that cover them and nothing else."""

import numpy as np
import pytest

from arm_blender.uv.given.polygons import MOST_CORNERS, triangulated

L = [(0, 0), (3, 0), (3, 2), (2, 2), (2, 1), (0, 1)]
ARROW = [(0, 0), (2, -1), (1, 0), (2, 1)]
COMB = [(0, 0), (7, 0), *((x, y) for x in range(6, 0, -1) for y in ((5, 1) if x % 2 else (1, 5))), (0, 5)]


def area(flat: np.ndarray) -> float:
    x, y = flat.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2.0)


def placed(outline, axes: np.ndarray) -> np.ndarray:
    """(N, 3): the outline in a plane of space."""
    return np.array([(x, y, 0.3) for x, y in outline], float) @ axes.T


@pytest.mark.parametrize(
    "outline", [L, ARROW, COMB, [(0, 0), (1, 0), (1, 1), (0, 1)]], ids=["L", "arrow", "comb", "square"]
)
@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("seed", [None, 1, 2])
def test_triangles_cover_a_polygon_and_nothing_else(outline, turn, seed):
    axes = np.eye(3) if seed is None else np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    corners = placed(outline[::-1] if turn else outline, axes)
    owner, found = triangulated(corners, [range(len(corners))])
    assert (owner == 0).all() and len(found) == len(corners) - 2
    a, b, c = np.moveaxis(corners[found], 1, 0)
    normals = np.cross(b - a, c - a) / 2.0
    whole = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0) / 2.0
    # As large as the polygon, and none turned over: then nothing sticks out, and nothing is covered twice.
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(abs(area(np.array(outline, float))))
    assert (normals @ whole > 0.0).all()


def test_every_starting_corner_will_do():
    for first in range(len(L)):
        corners = placed(L[first:] + L[:first], np.eye(3))
        _, found = triangulated(corners, [range(6)])
        a, b, c = np.moveaxis(corners[found], 1, 0)
        assert np.cross(b - a, c - a)[:, 2].min() > 0.0 and np.cross(b - a, c - a)[:, 2].sum() / 2 == pytest.approx(4.0)


def test_polygons_of_all_sizes_keep_their_order():
    corners = placed(L, np.eye(3))
    owner, found = triangulated(corners, [(0, 1, 2), (), (0, 1), (0, 1, 2, 3, 4, 5), (0, 1, 4, 5)])
    assert owner.tolist() == [0, 3, 3, 3, 3, 4, 4] and found.max() == 5


def test_what_crosses_itself_or_has_no_area_still_ends():
    bow = np.array([(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0), (0.5, 2, 0)], float)
    for corners in (bow, np.zeros((6, 3)), np.arange(6.0)[:, None] * np.ones(3)):
        owner, found = triangulated(corners, [range(len(corners))])
        assert len(found) == len(corners) - 2
    with pytest.raises(ValueError, match="triangulate"):
        triangulated(np.zeros((MOST_CORNERS + 1, 3)), [range(MOST_CORNERS + 1)])
