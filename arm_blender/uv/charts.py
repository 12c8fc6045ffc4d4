"""Charts by projection: what stands in where xatlas takes too long, or cannot be had.

Each face is projected along the axis that its normal is nearest to; faces that would overlap in the projection go to
different layers; what hangs together is a chart, and charts are packed on shelves.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from ..graphics.connectivity import components, manifold_pairs
from ..graphics.meshes import face_normals

BIN_LIMIT = 64
"""No face covers more than about this many bins a side in the search for overlaps: bounds its memory."""

PAIR_CHUNK = 2**20
"""Pairs of faces compared at once: bounds the memory to some 200 MB."""


def projection_charts(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Charts of a mesh in which no two faces overlap.

    Args:
        vertices: (N, 3) finite. faces: (F, 3) int64.
    Returns:
        (F,) int64 chart of each face, 0, 1, ...; (F, 3, 2) world units: corners in the plane of the chart, right-handed
        seen from the outside.
    """
    corners = vertices[faces]
    normal = face_normals(vertices, faces)
    axis = normal.abs().argmax(dim=1)
    positive = normal.gather(1, axis[:, None])[:, 0] >= 0
    first = torch.where(positive, (axis + 1) % 3, (axis + 2) % 3)
    second = torch.where(positive, (axis + 2) % 3, (axis + 1) % 3)
    plane = corners.gather(2, torch.stack([first, second], dim=1)[:, None].expand(-1, 3, 2))
    depth = corners.mean(dim=1).gather(1, axis[:, None])[:, 0]
    direction = 2 * axis + positive

    neighbours = manifold_pairs(faces) // 3
    chart = _connected(neighbours, direction, len(faces))
    layer = _layers(plane, depth, chart)
    return _connected(neighbours, direction * (int(layer.max()) + 1) + layer, len(faces)), plane


def pack(chart: Tensor, plane: Tensor, size: int, padding: int) -> Tensor:
    """(F, 3, 2) UVs in [0, 1] of charts in a square of `size` texels, at one scale, `padding` texels apart.

    Args:
        chart: (F,) int64. plane: (F, 3, 2), as `projection_charts` returns them.
    """
    count = int(chart.max()) + 1
    index = chart[:, None, None].expand(-1, 3, 2)
    low = plane.new_full((count, 3, 2), torch.inf).scatter_reduce(0, index, plane, "amin").amin(dim=1)
    high = plane.new_full((count, 3, 2), -torch.inf).scatter_reduce(0, index, plane, "amax").amax(dim=1)
    extent = high - low
    upright = extent[:, 1] > extent[:, 0]  # Laid down by a quarter turn: flat charts fill shelves better.
    local = plane - low[chart][:, None]
    turned = torch.stack([extent[chart, 1][:, None] - local[..., 1], local[..., 0]], dim=-1)
    local = torch.where(upright[chart][:, None, None], turned, local)
    extent = torch.where(upright[:, None], extent.flip(1), extent)

    # Very many charts leave no room for their gaps: then narrower ones, at last none.
    for gap in (padding, 1, 0):
        scale, origin = _largest_scale(extent.double().cpu(), size, gap)
        if scale > 0:
            break
    placed = local.double() * scale + origin.to(local.device)[chart][:, None]
    return (placed / size).clamp(0.0, 1.0).to(plane.dtype)


def _connected(neighbours: Tensor, group: Tensor, count: int) -> Tensor:
    same = group[neighbours[:, 0]] == group[neighbours[:, 1]]
    return components(neighbours[same], count)


def _layers(plane: Tensor, depth: Tensor, chart: Tensor) -> Tensor:
    """(F,) int64 layers such that faces of one chart and one layer do not overlap: depth peeling, by faces."""
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
    face, number = _enumerate(span.prod(dim=1))
    x, y = first[face, 0] + number % span[face, 0], first[face, 1] + number // span[face, 0]
    key = (chart[face] * (last[:, 1].max() + 1) + y) * (last[:, 0].max() + 1) + x
    key, order = key.sort()
    face = face[order]
    _, group, count = torch.unique_consecutive(key, return_inverse=True, return_counts=True)
    start = (torch.cumsum(count, dim=0) - count)[group]
    earlier = torch.arange(len(key), device=key.device) - start  # Every face of a bin meets those before it.
    # Cut where the running number of pairs fills a chunk.
    piece = torch.cumsum(earlier, dim=0) // PAIR_CHUNK
    for entries in torch.arange(len(key), device=key.device).split(
        torch.unique_consecutive(piece, return_counts=True)[1].tolist()
    ):
        entry, number = _enumerate(earlier[entries])
        entry = entries[entry]
        yield torch.stack([face[entry], face[start[entry] + number]], dim=1)


def _enumerate(counts: Tensor) -> tuple[Tensor, Tensor]:
    """(sum(counts),) owner of each item and (sum(counts),) its number 0, 1, ... within its owner."""
    owner = torch.repeat_interleave(counts)
    return owner, torch.arange(len(owner), device=counts.device) - (torch.cumsum(counts, dim=0) - counts)[owner]


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


def _largest_scale(extent: Tensor, size: int, gap: int) -> tuple[float, Tensor]:
    """The largest texels per world unit at which (C, 2) boxes fit, and their (C, 2) places; 0 where none does."""
    best, places = 0.0, torch.zeros_like(extent)
    low, high = 0.0, size / max(float(extent.max()), 1e-12)
    for _ in range(24):
        scale = (low + high) / 2
        trial = _shelves(extent * scale + gap, size)
        if trial is None:
            high = scale
        else:
            best, places, low = scale, trial + gap / 2, scale
    return best, places


def _shelves(boxes: Tensor, size: int) -> Tensor | None:
    """(C, 2) places of (C, 2) boxes on shelves in a square, the highest boxes first; None where they do not fit."""
    if float(boxes.max()) > size:
        return None
    order = boxes[:, 1].argsort(descending=True, stable=True)
    width, height = boxes[order].unbind(dim=1)
    right = torch.cumsum(width, dim=0)
    places = torch.zeros_like(boxes)
    start, level = 0, 0.0
    while start < len(boxes):
        left = right[start] - width[start]
        end = max(int(torch.searchsorted(right, left + size, right=True)), start + 1)
        if level + float(height[start]) > size:
            return None
        places[order[start:end], 0] = right[start:end] - width[start:end] - left
        places[order[start:end], 1] = level
        start, level = end, level + float(height[start])
    return places
