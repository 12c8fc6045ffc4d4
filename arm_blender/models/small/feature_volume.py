"""A coarse volume of what the views say, refined by a small 3-D U-Net (https://arxiv.org/abs/1606.06650).

Not in the paper. Points look themselves up one by one; only their neighbours tell that a facet of the visual hull,
where the cones of few views meet, is not a facet of the object. The plane tokens start from this volume, and points
read it.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...graphics.voxels import cell_centers
from .pixel_aligned import ViewFeatures

GEOMETRY = 11
"""Numbers that a cell knows beside the image features."""

COLORS = 7
"""Numbers that a cell knows of the views' colours: their mean, their spread, and how many views show it."""

SEEN = 0.45
"""World units behind the visual hull up to which a view's colour counts in a cell: as much as hulls bulge."""

MARGIN = 0.03
"""World units inside of an outline at which a view's colour counts by half."""


@dataclass(frozen=True)
class FeatureVolumeConfig:
    """Size of the volume and of the U-Net over it."""

    grid: int = 24
    """Cells a side; what is thinner than a cell is left to the points' own look-up. A multiple of 4. The time of a
    training step grows with its cube: 0.2 s on a core at 24, 0.7 s at 32."""
    channels: int = 16
    """Of the finest level; they double with each of the two coarser ones."""
    hidden: float | None = None
    """World units behind the surface that a view predicts, at which the view sees a cell with even odds. None: all
    views count alike, also those that cannot see the cell; the shipped weights were made so."""
    votes: bool = False
    """The volume has a say in the raw values past the decoder, and a loss of its own in training."""
    colors: bool = False
    """Cells compare the colours that the views show there: where the surface is, they agree."""
    detail: int = 0
    """Channels of a second volume of twice the cells a side (detail_volume.py); 0 for none."""

    def color_side(self, side: int) -> int:
        """Pixels a side of the colours that are compared, in pictures of `side` pixels: about a cell each."""
        return side // 2 if self.detail else side // 4


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


class FeatureVolume(nn.Module):
    """View features to a volume (B, C, G, G, G) over the box, indexed z, y, x."""

    def __init__(self, config: FeatureVolumeConfig, features: int) -> None:
        super().__init__()
        self.config = config
        fine, middle, coarse = (config.channels * 2**level for level in range(3))
        self.lift = nn.Conv3d(2 * features + GEOMETRY + (COLORS if config.colors else 0), fine, 1)
        self.fine_in, self.fine_out = ResidualBlock(fine), ResidualBlock(fine)
        self.middle_in, self.middle_out = ResidualBlock(middle), ResidualBlock(middle)
        self.coarse = nn.Sequential(ResidualBlock(coarse), ResidualBlock(coarse))
        self.down1 = nn.Conv3d(fine, middle, 2, stride=2)
        self.down2 = nn.Conv3d(middle, coarse, 2, stride=2)
        self.up2, self.up1 = nn.Conv3d(coarse, middle, 1), nn.Conv3d(middle, fine, 1)

    def cells(self, views: ViewFeatures) -> Tensor:
        """(B, inputs, G, G, G): mean and spread of the image features over the views, and geometry."""
        points = cell_centers(self.config.grid, views.maps.device).expand(views.maps.shape[0], -1, -1)
        seen = views.outlines.project(points)
        found = seen.sample(torch.cat([views.maps, views.depth], dim=2))
        features, surface = found[..., :-1], found[..., -1]
        _, distance = views.outlines.read(seen)
        # How far in front of the surfaces that the views predict: carved if far in front of any.
        front = surface - (seen.depth - views.outlines.range.unsqueeze(-1))
        ahead = seen.framed * (front / 0.15).tanh()
        mean, spread, total = self.pooled(features, front, seen.framed)
        hull = distance.amin(dim=1)
        geometry = [
            (hull / 0.05).tanh(),
            (hull / 0.2).tanh(),
            (distance / 0.2).tanh().mean(dim=1),
            ahead.mean(dim=1),
            ahead.amax(dim=1),
            ahead.amin(dim=1),
            (hull > 0).to(hull),
            total.squeeze(-1) / 6.0,
        ]
        cells = torch.cat([mean, spread, torch.stack(geometry, dim=-1), points], dim=-1)
        if self.config.colors:
            colors = halved(views.colors) if self.config.detail else views.colors
            clear = seen.framed * clear_of_outlines(distance)
            cells = torch.cat([cells, compared_colors(seen.sample(colors), front, clear)], dim=-1)
        return cells.transpose(1, 2).unflatten(-1, (self.config.grid,) * 3)

    def pooled(self, features: Tensor, front: Tensor, framed: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Mean and spread of features over the views that may see each cell, and how many those are.

        Args:
            features: (B, V, P, C).
            front: (B, V, P) world units by which a cell lies in front of the surface that the view predicts.
            framed: (B, V, P) 1 where the view frames the cell, else 0.
        Returns:
            (B, P, C), (B, P, C), (B, P, 1). The spread is the variance where all views count alike.
        """
        hidden = self.config.hidden
        if hidden is None:
            weight = framed.unsqueeze(-1)
            total = weight.sum(dim=1).clamp(min=1.0)
        else:
            # Where the surface is, the views that see it agree; what the others show there is something else.
            weight = (framed * ((front + hidden) / (0.5 * hidden)).sigmoid()).unsqueeze(-1) + 1e-4
            total = weight.sum(dim=1)
        mean = (weight * features).sum(dim=1) / total
        variance = (weight * (features - mean.unsqueeze(1)) ** 2).sum(dim=1) / total
        return mean, variance if hidden is None else (variance + 1e-6).sqrt(), total

    def forward(self, views: ViewFeatures) -> Tensor:
        """The refined volume (B, channels, G, G, G), indexed z, y, x."""
        fine = self.fine_in(self.lift(self.cells(views)))
        middle = self.middle_in(self.down1(fine))
        coarse = self.coarse(self.down2(middle))
        middle = self.middle_out(middle + F.interpolate(self.up2(coarse), scale_factor=2, mode="nearest"))
        return self.fine_out(fine + F.interpolate(self.up1(middle), scale_factor=2, mode="nearest"))


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
        front, framed: (B, V, P) as in `FeatureVolume.pooled`.
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


def plane_columns(volume: Tensor) -> Tensor:
    """Mean and maximum along each plane's normal: (B, 3, 2 * C, G, G), planes and axes as `triplane.sample_planes`."""
    columns = (volume, volume.transpose(2, 3), volume.permute(0, 1, 4, 3, 2))  # The normal first: z, y, x.
    pooled = [torch.cat([v.mean(dim=2), v.amax(dim=2)], dim=1) for v in columns]
    # After taking the normal away: (y, x), (z, x) and (y, z); rows are the plane's second coordinate.
    return torch.stack(pooled, dim=1)
