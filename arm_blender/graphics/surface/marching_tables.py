"""The 256 cases of marching cubes, derived from the geometry of the cube instead of being written out.

On each face of a cube the surface leaves directed segments between the crossed edges. Where the four corners of a face
alternate, inside corners are always kept apart: this depends on the face alone, so that two cubes that share it agree
and the surface is closed. The segments of a cube's six faces chain into loops, and each loop is cut into triangles
(Lorensen and Cline 1987; the choice of diagonals follows the requirement that no diagonal lies in a face of the cube,
where the neighbour could use it too and make the edge non-manifold).
"""

from functools import cache
from itertools import combinations

import torch
from torch import Tensor

CORNERS = tuple((c & 1, c >> 1 & 1, c >> 2 & 1) for c in range(8))
"""(x, y, z) of the 8 corners: bit k of a corner's number is its coordinate along axis k."""

EDGES = tuple((c, axis) for axis in range(3) for c in range(8) if not c >> axis & 1)
"""The 12 edges: the number of the lower corner, and the axis along which the edge leaves it."""


@cache
def triangle_table() -> tuple[Tensor, Tensor]:
    """Triangles of each case; bit c of a case's number says that corner c is inside.

    Returns:
        (256, 5, 3) int64: edge numbers of up to five triangles, counter-clockwise seen from the outside; 0 beyond the
        count. (256,) int64: their count.
    """
    table = torch.zeros(256, 5, 3, dtype=torch.int64)
    count = torch.zeros(256, dtype=torch.int64)
    for case in range(256):
        triangles = [t for loop in _loops(case) for t in _triangulate(loop)]
        count[case] = len(triangles)
        if triangles:
            table[case, : len(triangles)] = torch.tensor(triangles)
    return table, count


def _faces() -> list[list[int]]:
    """The corners of the six faces, counter-clockwise seen from outside the cube."""
    faces = []
    for axis in range(3):
        first, second = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        ring = [0, first, first | second, second]
        faces += [ring[::-1], [corner | 1 << axis for corner in ring]]
    return faces


def _edge_between(a: int, b: int) -> int:
    return EDGES.index((min(a, b), (a ^ b).bit_length() - 1))


def _loops(case: int) -> list[list[int]]:
    """Closed loops of edge numbers around the inside corners, counter-clockwise seen from the outside."""
    follows = {}
    for ring in _faces():
        inside = [bool(case >> corner & 1) for corner in ring]
        for k in range(4):
            if inside[k] and not inside[(k + 1) % 4]:
                start = k
                while inside[start - 1]:
                    start -= 1
                entering = _edge_between(ring[start - 1], ring[start])
                follows[entering] = _edge_between(ring[k], ring[(k + 1) % 4])
    loops = []
    while follows:
        first, edge = follows.popitem()
        loop = [first]
        while edge != first:
            loop.append(edge)
            edge = follows.pop(edge)
        loops.append(loop)
    return loops


def _triangulate(loop: list[int]) -> list[tuple[int, int, int]]:
    """The triangulation with the fewest diagonals in faces of the cube and, among those, the shortest diagonals."""
    return min(_triangulations(loop), key=lambda triangles: _cost(loop, triangles))


def _triangulations(loop: list[int]) -> list[list[tuple[int, int, int]]]:
    """Every way to cut a polygon into triangles: the triangle on its closing side, then what remains on both sides."""
    if len(loop) < 3:
        return [[]]
    return [
        [(loop[0], loop[k], loop[-1]), *left, *right]
        for k in range(1, len(loop) - 1)
        for left in _triangulations(loop[: k + 1])
        for right in _triangulations(loop[k:])
    ]


def _cost(loop: list[int], triangles: list[tuple[int, int, int]]) -> tuple[int, float]:
    sides = {frozenset(pair) for pair in zip(loop, loop[1:] + loop[:1], strict=True)}
    diagonals = {frozenset(pair) for triangle in triangles for pair in combinations(triangle, 2)} - sides
    in_face, length = 0, 0.0
    for a, b in diagonals:
        first, second = _middle(a), _middle(b)
        in_face += any(first[k] == second[k] != 0.5 for k in range(3))
        length += sum((first[k] - second[k]) ** 2 for k in range(3)) ** 0.5
    return in_face, length


def _middle(edge: int) -> tuple[float, ...]:
    corner, axis = EDGES[edge]
    return tuple(0.5 if k == axis else float(CORNERS[corner][k]) for k in range(3))
