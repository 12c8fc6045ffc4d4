"""What the shape is read from: the views' outlines, their colours, and how deep the visual hull lies in them."""

from dataclasses import dataclass

from torch import Tensor
from torch.nn import functional as F

from ...graphics.visual_hull import Outlines


@dataclass(frozen=True)
class HullViews:
    """B objects of V views each.

    Attributes:
        outlines: of the views, where points are found.
        depth: (B, V, 1, h, w) where rays meet the visual hull, beyond the origin's depth, world units.
        colors: (B, V, 4, h, w) sRGB of the object less a half, 0 where it is not, and coverage.
    """

    outlines: Outlines
    depth: Tensor
    colors: Tensor

    @classmethod
    def of(cls, outlines: Outlines, colors: Tensor) -> "HullViews":
        """Those of outlines and colours, with the hull's depth in as many pixels as the colours."""
        return cls(outlines, hull_buffer(outlines, colors.shape[-1])[:, :, 1:], colors)


def hull_buffer(outlines: Outlines, side: int) -> Tensor:
    """`Outlines.hull_depth`, (B, V, 2, side, side), found at half of the resolution: the hull is smooth."""
    found = outlines.hull_depth(side // 2)
    return F.interpolate(found.flatten(0, 1), scale_factor=2, mode="nearest").unflatten(0, found.shape[:2])
