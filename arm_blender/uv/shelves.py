"""Charts packed on shelves: what stands in where xatlas takes too long, or cannot be had."""

import torch
from torch import Tensor


def pack(chart: Tensor, plane: Tensor, size: int, padding: int) -> Tensor:
    """(F, 3, 2) UVs in [0, 1] of charts in a square of `size` texels, at one scale, `padding` texels apart.

    Args:
        chart: (F,) int64. plane: (F, 3, 2) world units: corners in the plane of their chart.
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
