"""How opaque an object is by its own picture: glass, and a soft matte, are objects as whole as any other.

All that comes later takes an alpha of a half for the outline, and what is clearly less than 1 for a mixture with the
background. Of a picture that is see-through all over neither is true, so its alpha is brought to that scale first.
"""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from ..graphics.windows import highest_around, lowest_around

_FAINT = 0.05
"""Alpha below which nothing is there: what compression leaves beside an object."""

_OPAQUE = 0.9
"""Alpha from which on a pixel is the object's alone; back-projection takes no colour below it."""

_OPAQUE_SHARE = 0.25
"""Of what is there, how much has to be opaque before the rest is taken for a shadow, or for what is blurred."""

_LEVEL = 0.25
"""Quantile of the alpha inside of a see-through object that becomes 1: what is a little fainter is still inside."""

_EDGE = 2
"""Pixels that an outline is wide."""

_THIN_SHARE = 0.02
"""Of the object's pixels, how many away from its outline may be see-through before anything is done."""

_LOOKED_AT = 1024
"""Pixels of a side that are looked at first: of a large picture most are spared where it is opaque."""

_FLAT = 0.9
"""Of the largest alpha nearby, from which on the smallest one belongs to the same surface."""


def solid(alpha: Tensor) -> Tensor:
    """(H, W) alpha under which the object is opaque but for its outline.

    An alpha that is so already comes back as it is.

    Args:
        alpha: (H, W) in [0, 1], of a picture or a mask.
    """
    step = max(1, max(alpha.shape) // _LOOKED_AT)
    if step > 1 and (few := alpha[::step, ::step]) is _solid(few):
        return alpha
    return _solid(alpha)


def _solid(alpha: Tensor) -> Tensor:
    """`solid`, of all pixels."""
    level = _level(alpha)
    scaled = alpha if level >= _OPAQUE else (alpha / level).clamp(max=1.0)
    inside = scaled > 0.5
    thin = _eroded(inside) & (scaled < _OPAQUE)
    if int(thin.sum()) <= _THIN_SHARE * int(inside.sum()):
        return scaled
    # See-through beside what is opaque: alpha counts beside that of its neighbours.
    smooth = avg_pool2d(scaled[None, None], 3, 1, 1, count_include_pad=False)[0, 0]
    highest, lowest = highest_around(smooth, _EDGE), lowest_around(smooth, _EDGE)
    risen = torch.where(lowest >= _FLAT * highest, 1.0, (scaled / highest.clamp(min=0.5)).clamp(max=1.0))
    return torch.where(inside, torch.maximum(risen, scaled), scaled)


def _level(alpha: Tensor) -> float:
    """The alpha that the object has, in (0, 1]; 1 where it is opaque, or nothing is there."""
    there = alpha > _FAINT
    inner = alpha[_eroded(there)]
    if len(inner) < 0.25 * int(there.sum()):  # It is hardly wider than its outline.
        inner = alpha[there]
    if not len(inner) or float((inner >= _OPAQUE).float().mean()) >= _OPAQUE_SHARE:
        return 1.0
    return float(inner.kthvalue(1 + int(_LEVEL * (len(inner) - 1))).values)


def _eroded(mask: Tensor) -> Tensor:
    """`mask` (H, W) bool without what is within `_EDGE` pixels of its outline."""
    return mask & (highest_around((~mask).float(), _EDGE) < 0.5)
