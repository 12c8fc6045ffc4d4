"""A second feature volume of twice the cells a side: where exactly the surface is that the coarse one found.

Not in the paper. Knowing roughly where the surface is, a cell also knows which views see it, and may trust their
colours at twice the resolution: where the surface is, they agree.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...graphics.visual_hull import Outlines, hull_vote
from ...graphics.voxels import cell_centers, sample_volume
from .feature_volume import COLORS, ResidualBlock, clear_of_outlines, compared_colors
from .hull_views import HullViews

GEOMETRY = 10
"""Numbers that a cell knows beside colours and the coarse volume's features."""

SEEN = (0.06, 0.2)
"""World units behind the coarse surface up to which a view's colour counts: near it, and where it bulges."""

STEPS = 44
"""Samples along a ray: about two cells apart, which is as fast as the coarse volume's logits change."""


class DetailVolume(nn.Module):
    """A coarse volume and its views to a finer one."""

    def __init__(self, grid: int, coarse: int, channels: int, hull_gain: float) -> None:
        """Cells a side and channels of the coarse volume, channels of this, and the gain of `hull_vote`."""
        super().__init__()
        self.grid, self.hull_gain = 2 * grid, hull_gain
        self.lift = nn.Conv3d(coarse + GEOMETRY + len(SEEN) * COLORS, channels, 1)
        self.blocks = nn.Sequential(ResidualBlock(channels), ResidualBlock(channels))

    def forward(self, views: HullViews, volume: Tensor, occupancy: Tensor) -> Tensor:
        """(B, channels, 2 G, 2 G, 2 G) indexed z, y, x.

        Args:
            views: whose outlines and colours are compared.
            volume: (B, C, G, G, G) the coarse features.
            occupancy: (B, 1, G, G, G) logits that the coarse volume gives its cells, the hull's vote left out.
        """
        size = (self.grid,) * 3
        points = cell_centers(self.grid, volume.device).expand(len(volume), -1, -1)
        seen = views.outlines.project(points)
        _, distance = views.outlines.read(seen)
        hull = distance.amin(dim=1)
        precise = torch.promote_types(occupancy.dtype, torch.float32)
        logit = F.interpolate(occupancy.to(precise), size=size, mode="trilinear")
        logit = logit.flatten(1) + hull_vote(hull, self.hull_gain)
        surface = meets(views.outlines, logit.detach().unflatten(1, (1, *size)), views.colors.shape[-1])
        depth = seen.sample(surface)[..., 0]
        front = depth - (seen.depth - views.outlines.range.unsqueeze(-1))
        ahead = seen.framed * (front / 0.06).tanh()
        geometry = [
            (hull / 0.03).tanh(),
            (hull / 0.15).tanh(),
            (logit / 2.0).tanh(),
            (logit / 10.0).tanh(),
            ahead.mean(dim=1),
            ahead.amax(dim=1),
            ahead.amin(dim=1),
        ]
        found, clear = seen.sample(views.colors), seen.framed * clear_of_outlines(distance)
        colors = [compared_colors(found, front, clear, reach) for reach in SEEN]
        cells = torch.cat([torch.stack(geometry, dim=-1), points, *colors], dim=-1)
        cells = cells.transpose(1, 2).unflatten(-1, size)
        coarse = F.interpolate(volume, size=size, mode="trilinear")
        return self.blocks(self.lift(torch.cat([coarse, cells.to(coarse)], dim=1)))


def meets(outlines: Outlines, logit: Tensor, side: int) -> Tensor:
    """(B, V, 1, side, side) depth beyond the origin's at which rays meet the solid of a grid of logits (B, 1, ...).

    A ray that meets nothing has the depth of those beside it, or sees the far side of the box: what it passes is empty.
    """

    def solid(item: int, points: Tensor) -> Tensor:
        return sample_volume(logit[item][None], points[None])[0, :, 0]

    met, depth = outlines.first_met(side, solid, STEPS).unbind(dim=2)
    depth = torch.where(met > 0, depth, torch.inf)
    # Twice, so that what is interpolated at an outline is the solid's depth, not half of the way to the far side.
    near = -F.max_pool2d(F.max_pool2d(-depth, 3, stride=1, padding=1), 3, stride=1, padding=1)
    return torch.where(depth.isfinite(), depth, torch.where(near.isfinite(), near, 1.0)).unsqueeze(2)
