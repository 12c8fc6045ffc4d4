"""Pictures side by side: what a network saw, what it made of it, and the truth."""

import torch
from torch import Tensor
from torch.nn import functional as F

from .losses import SurfaceMaps


def grid(rows: list[Tensor], side: int) -> Tensor:
    """One picture of all.

    Args:
        rows: each (V, 1 or 3, h, w) in [0, 1]; a shorter row ends in white.
        side: pixels of every picture; `nearest` where they are enlarged, so that pixels show.
    Returns:
        (3, rows * side, columns * side).
    """
    columns = max(len(row) for row in rows)
    strips = []
    for row in rows:
        mode = "area" if row.shape[-1] > side else "nearest"
        tiles = F.interpolate(row.float().expand(-1, 3, -1, -1), size=(side, side), mode=mode)
        tiles = F.pad(tiles, (0, 0, 0, 0, 0, 0, 0, columns - len(row)), value=1.0)
        strips.append(torch.cat(tuple(tiles), dim=-1))
    return torch.cat(strips, dim=-2).clamp(0.0, 1.0)


def normals(maps: SurfaceMaps) -> Tensor:
    """(V, 3, H, W) world normals as colours, white where nothing is."""
    opacity = maps.mask[:, None].clamp(0.0, 1.0)
    return 0.5 * (maps.normal + opacity) + 1.0 - opacity
