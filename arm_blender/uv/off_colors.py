"""Which views show other colours than the rest: pictures in the wrong place, though their outlines fit."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from ..graphics.color import srgb_from_linear
from ..structures import TexelViews

_OFF = 0.12
"""Median difference in sRGB from the blend at which a view is off: highlights and shadows leave most texels alike."""

_BEYOND = 3.0
"""Times the usual view's difference: what all pictures have is light, or a bad shape."""

_FEWEST_TEXELS = 64
"""Texels, seen by two others as well, below which a view is not judged."""


@torch.no_grad()
def off_colors(seen: TexelViews, colors: Tensor, names: Sequence[str]) -> Iterator[str]:
    """A sentence for each view whose colours are not those of the blend.

    Args:
        seen: what V >= 3 views say of texels.
        colors: (3, T, T) linear, their blend.
        names: of the views.
    """
    shared = seen.visibility.sum(dim=0) >= 3
    blended, medians = srgb_from_linear(colors), []
    for color, visible in zip(seen.color, seen.visibility, strict=True):
        where = visible & shared
        off = (srgb_from_linear(color[:, where]) - blended[:, where]).abs().amax(dim=0)
        medians.append(float(off.median()) if len(off) >= _FEWEST_TEXELS else 0.0)
    judged = [median for median in medians if median > 0.0]
    usual = sorted(judged)[(len(judged) - 1) // 2] if judged else 0.0
    for name, median in zip(names, medians, strict=True):
        if median > max(_OFF, _BEYOND * usual):
            yield f"{name} shows other colours than the rest (by {median:.0%}); check its place and its camera"
