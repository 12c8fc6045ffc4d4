"""Lists of unequal lengths, laid end to end."""

import torch
from torch import Tensor


def enumerate_items(counts: Tensor) -> tuple[Tensor, Tensor]:
    """(sum(counts),) owner of each item and (sum(counts),) its number 0, 1, ... within its owner.

    Args:
        counts: (N,) int64 >= 0, items of each owner.
    """
    owner = torch.repeat_interleave(counts)
    return owner, torch.arange(len(owner), device=counts.device) - (torch.cumsum(counts, dim=0) - counts)[owner]
