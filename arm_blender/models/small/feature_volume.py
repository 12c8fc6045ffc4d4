"""A coarse volume of what the views say, refined by a small 3-D U-Net (https://arxiv.org/abs/1606.06650).

Not in the paper. Points look themselves up one by one; only their neighbours tell that a facet of the visual hull,
where the cones of few views meet, is not a facet of the object. Where the surface is, the views agree on its colour.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...graphics.voxels import cell_centers
from .hull_views import HullViews

GEOMETRY = 11
"""Numbers that a cell knows of outlines and surfaces, and its place."""

COLORS = 7
"""Numbers that a cell knows of the views' colours: their mean, their spread, and how many views show it."""

SEEN = 0.45
"""World units behind the visual hull up to which a view's colour counts in a cell: as much as hulls bulge."""

MARGIN = 0.03
"""World units inside of an outline at which a view's colour counts by half."""

HIDDEN = 0.2
"""World units behind the visual hull at which a view is counted by half among those that see a cell."""


class ResidualBlock(nn.Module):
    """Two pre-normed convolutions within a residual, as (B, C, G, G, G)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm1, self.norm2 = nn.GroupNorm(4, channels), nn.GroupNorm(4, channels)
        self.conv1 = nn.Conv3d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv3d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        y = self.conv1(F.relu(self.norm1(x)))
        return x + self.conv2(F.relu(self.norm2(y)))


class VolumeUnet(nn.Module):
    """Cells (B, inputs, G, G, G) over the box to a volume (B, channels, G, G, G), both indexed z, y, x; 4 divides G."""

    def __init__(self, inputs: int, channels: int) -> None:
        super().__init__()
        fine, middle, coarse = (channels * 2**level for level in range(3))
        self.lift = nn.Conv3d(inputs, fine, 1)
        self.fine_in, self.fine_out = ResidualBlock(fine), ResidualBlock(fine)
        self.middle_in, self.middle_out = ResidualBlock(middle), ResidualBlock(middle)
        self.coarse = nn.Sequential(ResidualBlock(coarse), ResidualBlock(coarse))
        self.down1 = nn.Conv3d(fine, middle, 2, stride=2)
        self.down2 = nn.Conv3d(middle, coarse, 2, stride=2)
        self.up2, self.up1 = nn.Conv3d(coarse, middle, 1), nn.Conv3d(middle, fine, 1)

    def refine(self, cells: Tensor) -> Tensor:
        """The volume of the cells."""
        fine = self.fine_in(self.lift(cells))
        middle = self.middle_in(self.down1(fine))
        coarse = self.coarse(self.down2(middle))
        middle = self.middle_out(middle + F.interpolate(self.up2(coarse), scale_factor=2, mode="nearest"))
        return self.fine_out(fine + F.interpolate(self.up1(middle), scale_factor=2, mode="nearest"))


class FeatureVolume(VolumeUnet):
    """Outlines and colours to a volume (B, C, G, G, G) over the box."""

    def __init__(self, grid: int, channels: int) -> None:
        super().__init__(GEOMETRY + COLORS, channels)
        self.grid = grid

    def forward(self, views: HullViews) -> Tensor:
        """The refined volume, indexed z, y, x."""
        points = cell_centers(self.grid, views.depth.device).expand(len(views.depth), -1, -1)
        seen = views.outlines.project(points)
        _, distance = views.outlines.read(seen)
        front = seen.sample(views.depth)[..., 0] - (seen.depth - views.outlines.range.unsqueeze(-1))
        count = (seen.framed * ((front + HIDDEN) / (0.5 * HIDDEN)).sigmoid() + 1e-4).sum(dim=1)
        geometry = cell_geometry(distance, front, seen.framed, count)
        clear = seen.framed * clear_of_outlines(distance)
        colors = compared_colors(seen.sample(halved(views.colors)), front, clear)
        cells = torch.cat([geometry, points, colors], dim=-1)
        return self.refine(cells.transpose(1, 2).unflatten(-1, (self.grid,) * 3))


def cell_geometry(distance: Tensor, front: Tensor, framed: Tensor, count: Tensor) -> Tensor:
    """(B, P, GEOMETRY - 3) what cells know of outlines and surfaces.

    Args:
        distance: (B, V, P) signed silhouette distance, world units.
        front: (B, V, P) world units by which a cell lies in front of the surface that the view shows.
        framed: (B, V, P) 1 where the view frames the cell, else 0.
        count: (B, P) how many views may see the cell.
    """
    # Carved if far in front of any.
    ahead, hull = framed * (front / 0.15).tanh(), distance.amin(dim=1)
    numbers = [
        (hull / 0.05).tanh(),
        (hull / 0.2).tanh(),
        (distance / 0.2).tanh().mean(dim=1),
        ahead.mean(dim=1),
        ahead.amax(dim=1),
        ahead.amin(dim=1),
        (hull > 0).to(hull),
        count / 6.0,
    ]
    return torch.stack(numbers, dim=-1)


def object_colors(images: Tensor, background: float, side: int) -> Tensor:
    """(N, 4, side, side) mean sRGB of the object in each square of pixels, less a half, and coverage.

    Args:
        images: (N, 4, S, S) sRGB composited on a grey level, then coverage. background: that grey level.
    """
    own = torch.cat([images[:, :3] - (1.0 - images[:, 3:]) * background, images[:, 3:]], dim=1)
    own = F.adaptive_avg_pool2d(own, side)
    return torch.cat([(own[:, :3] / own[:, 3:].clamp(min=1e-3) - 0.5) * (own[:, 3:] > 0.05), own[:, 3:]], dim=1)


def clear_of_outlines(distance: Tensor) -> Tensor:
    """In (0, 1): how far a view's colour counts at a signed silhouette distance; near an outline it looks along the
    surface, and a pixel further may be anything."""
    return ((distance - MARGIN) / (0.3 * MARGIN)).sigmoid()


def halved(colors: Tensor) -> Tensor:
    """Colours (B, V, 4, h, w) as of `object_colors`, for squares of twice the size."""
    coverage = colors[:, :, 3:]
    images = torch.cat([(colors[:, :, :3] + 0.5) * coverage, coverage], dim=2)
    return object_colors(images.flatten(0, 1), 0.0, colors.shape[-1] // 2).unflatten(0, colors.shape[:2])


def compared_colors(found: Tensor, front: Tensor, framed: Tensor, seen: float = SEEN) -> Tensor:
    """What cells know of the colours of views that may see them.

    Args:
        found: (B, V, P, 4) colours and coverage as of `object_colors`.
        front, framed: (B, V, P) as of `cell_geometry`.
        seen: world units behind the surface at which a view counts by half.
    Returns:
        (B, P, COLORS).
    """
    color, coverage = found[..., :3], found[..., 3]
    weight = (framed * coverage * ((front + seen) / (seen / 3.0)).sigmoid()).unsqueeze(-1)
    total = weight.sum(dim=1)
    mean = (weight * color).sum(dim=1) / (total + 1e-3)
    variance = (weight * (color - mean.unsqueeze(1)).square()).sum(dim=1) / (total + 1e-3)
    return torch.cat([2.0 * mean, ((variance + 1e-5).sqrt() * 8.0).tanh(), total / 3.0], dim=-1)
