"""An atlas at a coarser resolution: means over cells that leave out gaps and hidden texels, and the way back."""

import torch
from torch import Tensor
from torch.nn import functional

from ..structures import TexelMap

DARK = 0.02
"""Linear. Added to a colour before it is scaled, so that black can be corrected too."""


def cells(x: Tensor, resolution: int) -> Tensor:
    """(C, n, n) means of `x` (C, T, T) over the cells of a coarser atlas."""
    side = x.shape[-1]
    if side == resolution:
        return x
    if side % resolution == 0:
        return functional.avg_pool2d(x, side // resolution)
    return functional.adaptive_avg_pool2d(x, resolution)


def mean(x: Tensor, share: Tensor) -> Tensor:
    """(C, n, n) means of `x` (C, T, T), which is 0 outside a mask, over that mask alone.

    `share` (1, n, n) is the part of each cell inside it; 0 where that is 0.
    """
    return cells(x, share.shape[-1]) / share.clamp(min=1e-6)


def surface_cells(texels: TexelMap, resolution: int) -> Tensor:
    """(7, n, n): share of each cell that a chart covers, mean position, mean normal."""
    share = cells(texels.mask[None].float(), resolution)
    return torch.cat([share, mean(texels.position, share), mean(texels.normal, share)])


def resized(x: Tensor, side: int) -> Tensor:
    """Bilinear resampling of (C, n, n) to `side`."""
    if x.shape[-1] == side:
        return x
    return functional.interpolate(x[None], (side, side), mode="bilinear")[0]


def enlarged(x: Tensor, share: Tensor, side: int) -> Tensor:
    """(C, T, T) from (C, n, n), weighted by the share (1, n, n) of each cell that is covered.

    What a network says of the gaps never reaches a chart.
    """
    if x.shape[-1] == side:
        return x
    return resized(x * share, side) / resized(share, side).clamp(min=1e-6)


def scaled(color: Tensor, log_gain: Tensor) -> Tensor:
    """`color` made exp(log_gain) times as bright, exactly itself where that is 0; in [0, 1]."""
    return (color + (color + DARK) * torch.expm1(log_gain)).clamp(0.0, 1.0)


def log_gain(target: Tensor, color: Tensor) -> Tensor:
    """What makes `color` the `target` by `scaled`; both linear in [0, 1]."""
    return ((target + DARK) / (color + DARK)).log()
