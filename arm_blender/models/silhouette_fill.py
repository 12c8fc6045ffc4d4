"""A density that fills the silhouettes: wherever a view shows the object, something along the ray is solid.

Not in the paper. A network asked point by point for its belief shrinks what it is unsure of: the even odds of many
possible surfaces lie within most of them, so that outlines recede everywhere, though the masks say exactly where they
are. Here a ray through a silhouette that meets nothing solid has what it believes in most raised until it does. What no
outline needs may then be carved more boldly.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from .feature_volume import cell_centers, sample_volume
from .visual_hull import Outlines

GRID = 64
"""Cells a side at which the belief is looked up along rays."""

SIDE, STEPS = 160, 86
"""Pixels a side of the silhouettes that are filled, and samples along a ray: more than one a cell."""

CARVED = 0.6
"""Logits taken from the network's before silhouettes are filled. Of 0, 0.3, 0.6 and 1 the best on held-out objects:
less leaves the bulges of the visual hull, more opens thin walls."""

LEVEL = 0.5
"""Logits above the surface to which a ray is raised: its pixel's centre lies inside."""

MOST = 6.0
"""Logits by which a ray is raised at most: masks that disagree must not make matter out of nothing."""

FALLOFF = 0.5
"""Logits below the highest of its ray at which a point is raised e times less."""

EMPTY = -20.0
"""The logit of what lies outside of the visual hull by more than a cell."""


@dataclass(frozen=True)
class SilhouetteFill:
    """What rays lack, for one object.

    Attributes:
        outlines: of its views, B = 1.
        lack: (1, V, 2, SIDE, SIDE) logits to add along each pixel's ray, and the highest on it.
    """

    outlines: Outlines
    lack: Tensor

    @classmethod
    def of(cls, logit: Callable[[Tensor], Tensor], outlines: Outlines, chunk: int) -> "SilhouetteFill":
        """Of a field: `logit` takes (P, 3) world points, at most `chunk` at once, and gives (P,)."""
        centers = cell_centers(GRID, outlines.c2w.device)
        near = torch.cat([outlines.hull_distance(part[None])[0] for part in centers.split(chunk)]) > -2.0 / GRID
        values = centers.new_full((len(centers),), EMPTY)
        within = near.nonzero()[:, 0]
        for part in within.split(chunk) if len(within) else ():
            values[part] = logit(centers[part])
        grid = values.view(1, 1, GRID, GRID, GRID)
        highest = outlines.highest(SIDE, lambda _, points: sample_volume(grid, points[None])[0, :, 0], STEPS, EMPTY)
        lack = (LEVEL - highest).clamp(0.0, MOST)
        # Beside a silhouette as at its edge, for between pixels both are interpolated.
        beside = -F.max_pool2d(-highest, 3, stride=1, padding=1)
        highest = torch.where(highest.isfinite(), highest, beside).clamp(max=-EMPTY)
        return cls(outlines, torch.stack([lack, highest], dim=2))

    def raised(self, points: Tensor, logit: Tensor) -> Tensor:
        """The logits (P,) of world points (P, 3), raised where a silhouette needs them."""
        seen = self.outlines.project(points[None])
        lack, highest = seen.sample(self.lack)[0].unbind(-1)  # (V, P)
        share = (-(highest - logit).clamp(min=0.0) / FALLOFF).exp() * seen.framed[0]
        return logit + (lack * share).amax(dim=0)
