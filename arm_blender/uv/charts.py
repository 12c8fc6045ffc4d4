"""Where a surface is cut, so that each piece, a chart, flattens well.

Each face takes one of the six axes as its label, the one that its normal is near to; labels are smoothed until seams
are short (iterated conditional modes on a Potts model: Besag, "On the statistical analysis of dirty pictures", 1986).
What hangs together is a chart, and the smallest join a neighbour.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from ..graphics.connectivity import components, half_edges, manifold_pairs
from ..graphics.meshes import face_areas, face_normals
from .overlaps import layers

SWEEPS = 12
"""Of smoothing; the labels hardly change after ten."""

STEEP = 0.35
"""Cosine to its axis below which a face is charged ten times over: it would be flattened badly."""

SMALL = 0.003
"""Share of the surface below which a chart joins a neighbour."""


def smooth_charts(vertices: Tensor, faces: Tensor) -> Tensor:
    """(F,) int64: charts 0, 1, ... that hang together, few and with short seams; each faces about one way.

    Args:
        vertices: (N, 3) finite. faces: (F, 3) int64.
    """
    normal, area = face_normals(vertices, faces), face_areas(vertices, faces)
    pairs = manifold_pairs(faces)
    neighbours = pairs // 3
    start, end = half_edges(faces)[pairs[:, 0]].unbind(dim=1)
    length = (vertices[start] - vertices[end]).norm(dim=1)
    label = _smoothed(normal, area, neighbours, length)
    return _merged(connected(neighbours, label, len(faces)), normal, area, neighbours, length)


def projection_charts(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Charts in which no two faces overlap, without any smoothing: each face lies along the axis it is nearest to.

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
    chart = connected(neighbours, direction, len(faces))
    layer = layers(plane, depth, chart)
    return connected(neighbours, direction * (int(layer.max()) + 1) + layer, len(faces)), plane


def connected(neighbours: Tensor, group: Tensor, count: int) -> Tensor:
    """(count,) int64: which parts hang together across `neighbours` (E, 2) of the same `group` (count,)."""
    same = group[neighbours[:, 0]] == group[neighbours[:, 1]]
    return components(neighbours[same], count)


def _smoothed(normal: Tensor, area: Tensor, neighbours: Tensor, length: Tensor) -> Tensor:
    """(F,) int64 axis of each face: what it costs to lie along it, against the seams to its neighbours."""
    axes = torch.eye(3, device=normal.device, dtype=normal.dtype)
    cosine = normal @ torch.cat([axes, -axes]).T
    cost = area[:, None] * (1.0 - cosine + 10.0 * (cosine < STEEP))
    label = cost.argmin(dim=1)
    if not len(neighbours):
        return label
    this, other = torch.cat([neighbours, neighbours.flip(1)]).unbind(dim=1)
    weight = (length * (area.mean() / length.mean().clamp(min=1e-12))).repeat(2)
    generator = torch.Generator().manual_seed(0)
    for _ in range(SWEEPS):
        agreement = torch.zeros_like(cost).index_put_((this, label[other]), weight, accumulate=True)
        # Not all at once: neighbours that change together would change back together.
        moving = (torch.rand(len(label), generator=generator) < 0.6).to(label.device)
        label = torch.where(moving, (cost - agreement).argmin(dim=1), label)
    return label


def _merged(chart: Tensor, normal: Tensor, area: Tensor, neighbours: Tensor, length: Tensor) -> Tensor:
    """`chart` (F,) in which small charts have joined the neighbour that they share the longest seam with."""
    while True:
        count = int(chart.max()) + 1
        size = area.new_zeros(count).index_add_(0, chart, area)
        facing = F.normalize(normal.new_zeros(count, 3).index_add_(0, chart, normal * area[:, None]), dim=1)
        sides = chart[neighbours]
        seam = sides[:, 0] != sides[:, 1]
        low, high = sides[seam].aminmax(dim=1)
        key, edge = torch.unique(low * count + high, return_inverse=True)
        shared = length.new_zeros(len(key)).index_add_(0, edge, length[seam])
        a, b = key // count, key % count
        outline = length.new_zeros(count).index_add_(0, a, shared).index_add_(0, b, shared)
        small, large = torch.where(size[a] < size[b], a, b), torch.where(size[a] < size[b], b, a)
        cosine = (facing[a] * facing[b]).sum(dim=1)
        score = shared / outline[small].clamp(min=1e-12) + 0.2 * cosine
        score = torch.where((size[small] < SMALL * size.sum()) & (cosine > 0.0), score, -1.0)
        best = score.new_full((count,), -1.0).scatter_reduce(0, small, score, "amax")
        joining = (score > 0.0) & (score == best[small])
        target = torch.arange(count, device=chart.device)
        target[small[joining]] = large[joining]
        # A chart joins only one that stays, or chains would join charts that do not touch.
        target = torch.where(target[target] == target, target, torch.arange(count, device=chart.device))
        if bool((target == torch.arange(count, device=chart.device)).all()):
            return chart
        chart = torch.unique(target[chart], return_inverse=True)[1]
