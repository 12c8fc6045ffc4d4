"""Faces of a mesh that pass through each other: candidates from a grid of cells, then exact tests."""

import torch
from torch import Tensor

from .ragged import enumerate_items, in_pieces

CELL = 1.5
"""Mean edge lengths of a cell's side: a face of usual size lies in a few cells, and few faces in one."""


def crossing_faces(vertices: Tensor, faces: Tensor) -> Tensor:
    """(C, 2) pairs of faces that cross and share no vertex, the lower first; each pair once.

    Faces that only touch, or lie in one plane, do not cross.

    Args:
        vertices: (N, 3). faces: (F, 3) int64, of about one size: a face much larger than the mean lies in many cells.
    """
    pairs = _neighbours_in_space(vertices[faces], faces)
    apart = (faces[pairs[:, 0]][:, :, None] != faces[pairs[:, 1]][:, None, :]).flatten(1).all(dim=1)
    pairs = pairs[apart]
    corners = vertices[faces].double()

    def crossed(pair: Tensor) -> tuple[Tensor]:
        first, second = corners[pair[:, 0]], corners[pair[:, 1]]
        return (_pierces(first, second) | _pierces(second, first),)

    return pairs[in_pieces(crossed, pairs)[0]] if len(pairs) else pairs


def _neighbours_in_space(corners: Tensor, faces: Tensor) -> Tensor:
    """(P, 2) pairs of faces whose boxes overlap, the lower first; `corners` are (F, 3, 3)."""
    low, high = corners.amin(dim=1), corners.amax(dim=1)
    cell = CELL * (corners - corners.roll(1, dims=1)).norm(dim=2).mean().clamp(min=1e-12)
    first, last = ((end - low.amin(dim=0)).div(cell).floor().long() for end in (low, high))
    size = last - first + 1
    owner, number = enumerate_items(size.prod(dim=1))
    place = torch.stack(
        [
            number % size[owner, 0],
            number // size[owner, 0] % size[owner, 1],
            number // (size[owner, 0] * size[owner, 1]),
        ],
        dim=1,
    )
    x, y, z = (first[owner] + place).unbind(dim=1)
    side = int(last.max()) + 1
    cells, order = ((z * side + y) * side + x).sort(stable=True)
    owner = owner[order]
    # Every face with those behind it in its cell; as many as there are up to the cell's last.
    _, count = torch.unique_consecutive(cells, return_counts=True)
    end = count.cumsum(0).repeat_interleave(count)
    here, ahead = enumerate_items(end - torch.arange(len(cells), device=cells.device) - 1)
    a, b = owner[here], owner[here + ahead + 1]
    overlap = ((low[a] <= high[b]) & (low[b] <= high[a])).all(dim=1)
    a, b = a[overlap], b[overlap]
    key = torch.unique(torch.minimum(a, b) * len(faces) + torch.maximum(a, b))
    return torch.stack([key // len(faces), key % len(faces)], dim=1)


def _pierces(first: Tensor, second: Tensor) -> Tensor:
    """(P,) bool: whether an edge of triangles (P, 3, 3) passes through the inside of other triangles (P, 3, 3)."""
    a, b, c = second.unbind(dim=1)
    normal = torch.linalg.cross(b - a, c - a, dim=1)
    height = ((first - a[:, None]) * normal[:, None]).sum(dim=2)  # (P, 3)
    found = torch.zeros(len(first), dtype=torch.bool, device=first.device)
    for corner in range(3):
        start, end = first[:, corner], first[:, (corner + 1) % 3]
        along, beyond = height[:, corner], height[:, (corner + 1) % 3]
        apart = along * beyond < 0.0
        share = along / torch.where(apart, along - beyond, 1.0)
        point = torch.lerp(start, end, share[:, None])
        sides = torch.stack(
            [(torch.linalg.cross(q - p, point - p, dim=1) * normal).sum(dim=1) for p, q in ((a, b), (b, c), (c, a))]
        )
        found |= apart & (sides > 0.0).all(dim=0)
    return found
