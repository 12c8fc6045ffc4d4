"""Long lists: those of unequal lengths laid end to end, and those worked through piece by piece."""

from collections.abc import Callable

import torch
from torch import Tensor

PIECE = 1 << 16
"""Rows of a piece: what is computed for them stays in the cache of a core, in memory that is not asked for anew."""


def enumerate_items(counts: Tensor) -> tuple[Tensor, Tensor]:
    """(sum(counts),) owner of each item and (sum(counts),) its number 0, 1, ... within its owner.

    Args:
        counts: (N,) int64 >= 0, items of each owner.
    """
    owner = torch.repeat_interleave(counts)
    return owner, torch.arange(len(owner), device=counts.device) - (torch.cumsum(counts, dim=0) - counts)[owner]


def runs(counts: Tensor, limit: int) -> tuple[Tensor, ...]:
    """Indices of (N,) counts, cut into runs whose counts sum to about `limit`."""
    run = torch.div(counts.cumsum(dim=0), limit, rounding_mode="floor")
    sizes = torch.unique_consecutive(run, return_counts=True)[1].tolist()
    return torch.arange(len(counts), device=counts.device).split(sizes)


def in_pieces(function: Callable[..., tuple[Tensor, ...]], *lists: Tensor) -> tuple[Tensor, ...]:
    """`function` of lists (P, ...), piece by piece; it returns a tuple of (P, ...), each row of its own rows alone."""
    pieces = zip(*(rows.split(PIECE) for rows in lists), strict=True)
    return tuple(torch.cat(parts) for parts in zip(*(function(*piece) for piece in pieces), strict=True))
