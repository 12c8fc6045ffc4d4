"""Which faces of a chart lie over one another in its plane."""

from collections.abc import Iterator

import torch
from torch import Tensor

from ..graphics.ragged import enumerate_items, runs

BIN_LIMIT = 64
"""No face covers more than about this many bins a side in the search for overlaps: bounds its memory."""

PAIR_CHUNK = 2**20
"""Pairs of faces compared at once: bounds the memory to some 200 MB."""


def layers(plane: Tensor, depth: Tensor, chart: Tensor) -> Tensor:
    """(F,) int64 layers such that faces of one chart and one layer do not overlap: depth peeling, by faces.

    Args:
        plane: (F, 3, 2) corners in the plane of their chart. depth: (F,) the highest face of a place is layer 0.
        chart: (F,) int64.
    """
    layer = torch.zeros_like(chart)
    # Doubles: neighbours share an edge exactly, and rounding must not make them overlap.
    pairs = torch.cat(
        [_overlapping(plane.double(), pairs) for pairs in _candidate_pairs(plane, chart)] or [chart[:0, None]]
    )
    if not len(pairs):
        return layer
    a, b = pairs.unbind(dim=1)
    a_above = (depth[a] > depth[b]) | ((depth[a] == depth[b]) & (a < b))
    above, below = torch.where(a_above, a, b), torch.where(a_above, b, a)
    while True:
        pushed = layer.scatter_reduce(0, below, layer[above] + 1, "amax")
        if torch.equal(pushed, layer):
            return layer
        layer = pushed


def _candidate_pairs(plane: Tensor, chart: Tensor) -> Iterator[Tensor]:
    """(P, 2) pairs of faces of one chart that meet in a bin of a square grid over the plane, some more than once."""
    low, high = plane.amin(dim=1), plane.amax(dim=1)
    extent = (high - low).amax(dim=1)
    bin_size = torch.maximum(2 * extent.mean(), extent.max() / BIN_LIMIT).clamp(min=1e-12)
    origin = low.amin(dim=0)
    first, last = ((low - origin) / bin_size).long(), ((high - origin) / bin_size).long()
    span = last - first + 1
    face, number = enumerate_items(span.prod(dim=1))
    x, y = first[face, 0] + number % span[face, 0], first[face, 1] + number // span[face, 0]
    key = (chart[face] * (last[:, 1].max() + 1) + y) * (last[:, 0].max() + 1) + x
    key, order = key.sort()
    face = face[order]
    _, group, count = torch.unique_consecutive(key, return_inverse=True, return_counts=True)
    start = (torch.cumsum(count, dim=0) - count)[group]
    earlier = torch.arange(len(key), device=key.device) - start  # Every face of a bin meets those before it.
    for entries in runs(earlier, PAIR_CHUNK):
        entry, number = enumerate_items(earlier[entries])
        entry = entries[entry]
        yield torch.stack([face[entry], face[start[entry] + number]], dim=1)


def _overlapping(plane: Tensor, pairs: Tensor) -> Tensor:
    """Those of (P, 2) pairs whose triangles share some area: no side of either separates them."""
    low, high = plane.amin(dim=1), plane.amax(dim=1)
    a, b = pairs.unbind(dim=1)
    pairs = pairs[((low[a] < high[b]) & (low[b] < high[a])).all(dim=1)]
    a, b = plane[pairs[:, 0]], plane[pairs[:, 1]]
    tolerance = 1e-9 * float((high - low).max())
    overlap = torch.ones(len(pairs), dtype=torch.bool, device=plane.device)
    for triangle in (a, b):
        side = triangle.roll(-1, dims=1) - triangle
        across = torch.stack([-side[..., 1], side[..., 0]], dim=-1)  # (P, 3 sides, 2)
        on_a, on_b = across @ a.mT, across @ b.mT  # (P, 3 sides, 3 corners)
        common = torch.minimum(on_a.amax(2), on_b.amax(2)) - torch.maximum(on_a.amin(2), on_b.amin(2))
        overlap &= (common > tolerance * torch.linalg.vector_norm(across, dim=-1)).all(dim=1)
    return pairs[overlap]
