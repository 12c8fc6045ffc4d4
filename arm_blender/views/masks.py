"""Regions of a picture: what a flood reaches, and which parts are too small to be meant."""

import torch
from torch import Tensor

from ..graphics.windows import lowest_around

_MINIMUM_SHARE = 2e-4
"""Of all pixels, how many must be foreground: three pixels of a view of 128 x 128, not a speck of dust."""

_SPECK_SHARE = 0.01
"""Of the largest part's pixels; what is smaller and touches nothing is noise, and would move the crop."""


_EDGE = 0.008
"""Of the picture's longer side, half of how wide the soft edge of an object may be."""

_TORN_SHARE = 0.015
"""Of an object's pixels, how many beyond soft edges may be neither it nor background. Set on 32 pictures of captures of
training objects: with 0.015 the small network's 15 masks of an IoU below 0.8 have 13 doubts, the 17 others 2; with 0.03
they have 9 and none."""

_BORDER_SHARE = 0.35
"""Of the picture's border, how much an object may take: more than one side and a half is rather the ground."""

_RIVAL_SHARE = 0.4
"""Of the largest part's pixels, how many the second one may have."""


_MOST_OF_IT, _PIECES = 0.8, 5
"""Share of a mask that so many pieces have to make up; what needs more is a pattern of the background."""


class Unsure(Exception):
    """A way to find the object does not trust its own result; the message says why, for a longer one."""


def sees_something(alpha: Tensor) -> bool:
    """Whether enough of `alpha` (H, W) is opaque for an object to be there."""
    return int((alpha > 0.5).sum()) >= max(3, _MINIMUM_SHARE * alpha.numel())


def doubt(alpha: Tensor) -> str | None:
    """What about a mask (H, W) that was found by itself is not like that of one whole object; None where nothing is.

    A doubtful mask may be right all the same, such as that of a close-up.
    """
    mask = alpha > 0.5
    torn = ((alpha > 0.15) & (alpha < 0.85)).float()
    reach = max(1, round(_EDGE * max(alpha.shape)))
    # A soft edge is narrow, and gone once what is torn is taken back from both sides.
    torn = lowest_around(torn, reach)
    if float(torn.sum()) > _TORN_SHARE * int(mask.sum()):
        return "how far the object reaches is not certain"
    border = torch.cat([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    if float(border.float().mean()) > _BORDER_SHARE:
        return "it reaches along much of the picture's border"
    areas = torch.bincount(parts(mask).flatten())[1:].sort(descending=True).values
    if len(areas) > 1 and int(areas[1]) > _RIVAL_SHARE * int(areas[0]):
        return "it has several parts of about one size"
    return None


def shreds(alpha: Tensor) -> str | None:
    """In how many pieces a mask (H, W) is, where they are those of no object; None where it has a main part or few."""
    mask = alpha > 0.5
    areas = torch.bincount(parts(mask).flatten())[1:].sort(descending=True).values.double()
    areas = areas[areas > 0]
    if not len(areas):
        return None
    needed = 1 + int((areas.cumsum(dim=0) < _MOST_OF_IT * areas.sum()).sum())
    if needed <= _PIECES:
        return None
    return f"it is in {len(areas)} pieces over {float(mask.float().mean()):.0%} of the picture"


def flooded(seeds: Tensor, passable: Tensor) -> Tensor:
    """The pixels (H, W) of `passable` that a path of passable pixels, edge to edge, connects to one of `seeds`."""
    part = parts(passable)
    reached = torch.zeros(int(part.max()) + 1, dtype=torch.bool, device=part.device)
    reached[part[seeds & passable]] = True
    return reached[part] & passable


def without_specks(mask: Tensor) -> Tensor:
    """`mask` (H, W) bool without the parts that are tiny beside its largest one."""
    part = parts(mask)
    areas = torch.bincount(part.flatten())
    areas[0] = 0
    return mask & (areas >= _SPECK_SHARE * areas.max())[part]


def parts(mask: Tensor) -> Tensor:
    """(H, W) int: the number of the part that each pixel of `mask` (H, W) bool belongs to, edge to edge; 0 for none.

    Runs of pixels in a row are joined where they touch those of the next row: there are far fewer runs than pixels.
    """
    starts = mask.clone()
    starts[:, 1:] &= ~mask[:, :-1]
    run = starts.flatten().cumsum(0, dtype=torch.int32).view_as(mask)
    touching = mask[1:] & mask[:-1]
    pairs = torch.stack([run[:-1][touching], run[1:][touching]])
    # Two runs touch along many pixels, one after the other.
    fresh = torch.ones(pairs.shape[1], dtype=torch.bool, device=mask.device)
    fresh[1:] = (pairs[:, 1:] != pairs[:, :-1]).any(dim=0)
    above, below = pairs[:, fresh].long()
    number = torch.arange(int(run[-1, -1]) + 1, device=mask.device)
    while not torch.equal(number[above], number[below]):
        lower = torch.minimum(number[above], number[below])
        for side in (above, below):
            number = number.scatter_reduce(0, number[side], lower, "amin")
        number = number[number]
    return number[run] * mask
