"""Pixel-aligned features: a point looks itself up in every view (PIFu, https://arxiv.org/abs/1905.05172).

Not in the paper. A triplane alone learns where things are from millions of images; a small network on a CPU gets it
from projection. For each view a point finds the image features, the coverage and the signed distance to the silhouette
there, and how far it lies in front of the surface that the view itself seems to show (a depth predicted for each pixel
and supervised in training). The views are pooled so that their number and order do not matter. What they disagree on
(the variance) tells free space from surface, and the smallest silhouette distance is the visual hull: a start that
learning carves.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...graphics.visual_hull import Outlines


@dataclass(frozen=True)
class PixelAlignedConfig:
    """What a point reads in the views, and how far it trusts their outlines."""

    channels: int = 24
    """Of the convolutional features at half of the image's resolution."""
    hidden: int = 48
    """Of the network that reads a point in one view, and of each pooled feature."""
    normed: bool = False
    """Features have mean 0 and variance 1 at each pixel. Without, they grow until they drown the geometry that stands
    beside them in whatever reads both; the shipped weights were made so."""
    hull_gain: float = 50.0
    """Occupancy logits for each world unit outside of the visual hull, or (a little way) inside: where learning starts.
    About 1 / temperature of the occupancy warm-up; 0 leaves the hull to be learnt from the features."""


@dataclass(frozen=True)
class ViewFeatures:
    """What points look up. B objects of V views each.

    Attributes:
        maps: (B, V, C, h, w) image features.
        depth: (B, V, 1, h, w) predicted depth of the visible surface beyond the origin's, world units.
        outlines: of the views, where points are found.
        colors: (B, V, 4, h, w) sRGB of the object less a half, 0 where it is not, and coverage; None where the feature
            volume does not compare colours.
    """

    maps: Tensor
    depth: Tensor
    outlines: Outlines
    colors: Tensor | None = None


class ResidualConv(nn.Module):
    """x + conv(relu(conv(relu(x)))), as (B, C, H, W)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class FeaturePyramid(nn.Module):
    """A view to features and depth at half resolution; the image encoder's tokens and the hull join at a quarter."""

    INPUTS = 6

    def __init__(self, channels: int, token_width: int, normed: bool) -> None:
        super().__init__()
        self.normed = normed
        self.to_half = nn.Sequential(nn.Conv2d(self.INPUTS, channels, 3, stride=2, padding=1), ResidualConv(channels))
        self.to_quarter = nn.Sequential(
            nn.Conv2d(channels + 2, 2 * channels, 3, stride=2, padding=1),
            ResidualConv(2 * channels),
            ResidualConv(2 * channels),
        )
        self.from_tokens = nn.Conv2d(token_width, 2 * channels, 1)
        self.merge = nn.Sequential(
            ResidualConv(2 * channels), nn.ReLU(), nn.Conv2d(2 * channels, channels, 3, padding=1)
        )
        self.to_depth = nn.Sequential(ResidualConv(channels), nn.ReLU(), nn.Conv2d(channels, 1, 1))

    def forward(self, images: Tensor, tokens: Tensor, hull: Tensor) -> tuple[Tensor, Tensor]:
        """Features (B, C, H/2, W/2) and depth (B, 1, H/2, W/2).

        Args:
            images: (B, 6, H, W) colour, coverage, silhouette distance and size of a pixel in world units.
            tokens: (B, D, h, w).
            hull: (B, 2, H/2, W/2) whether the visual hull is met, and its depth: what the depth starts from.
        """
        half = self.to_half(images)
        quarter = self.to_quarter(torch.cat([F.relu(half), hull], dim=1))
        tokens = F.interpolate(self.from_tokens(tokens), size=quarter.shape[-2:], mode="bilinear", align_corners=False)
        merged = self.merge(quarter + tokens)
        features = half + F.interpolate(merged, size=half.shape[-2:], mode="bilinear", align_corners=False)
        depth = hull[:, 1:] + self.to_depth(features)
        if self.normed:
            features = F.layer_norm(features.movedim(1, -1), features.shape[1:2]).movedim(-1, 1)
        return features, depth


GEOMETRY = 14
"""Numbers of `Lookup.geometry`."""


@dataclass(frozen=True)
class Lookup:
    """What P points of B objects find in V views.

    Attributes:
        features: (B, V, P, C) of the images.
        geometry: (B, V, P, GEOMETRY) coverage, silhouette distance at three scales, whether framed, depth beyond the
            origin's at two scales, size of a pixel, how far in front of the view's surface at three scales, direction
            to the camera.
        framed: (B, V, P) 1 where the view frames the point, else 0.
        distance: (B, V, P) signed silhouette distance, world units at the point's depth; a positive constant where
            unframed: such a view says neither inside nor outside.
    """

    features: Tensor
    geometry: Tensor
    framed: Tensor
    distance: Tensor


def look_up(views: ViewFeatures, points: Tensor) -> Lookup:
    """Project world points (B, P, 3) into every view and read what is there, bilinearly."""
    outlines = views.outlines
    seen = outlines.project(points)
    found = seen.sample(torch.cat([views.maps, views.depth], dim=2))
    features, surface = found[..., :-1], found[..., -1]
    coverage, distance = outlines.read(seen)
    offset = seen.depth - outlines.range.unsqueeze(-1)
    ahead = surface - offset
    direction = F.normalize(-seen.local, dim=-1) @ outlines.c2w[..., :3, :3].transpose(-1, -2)
    scalars = [
        coverage,
        (distance / 0.03).tanh(),
        (distance / 0.15).tanh(),
        (distance / 0.5).tanh(),
        seen.framed,
        offset,
        (offset / 0.2).tanh(),
        seen.pixel * 50.0,
        ahead,
        (ahead / 0.04).tanh(),
        (ahead / 0.2).tanh(),
    ]
    return Lookup(features, torch.cat([torch.stack(scalars, dim=-1), direction], dim=-1), seen.framed, distance)


class PointReader(nn.Module):
    """Reads points in all views and pools what it finds."""

    def __init__(self, config: PixelAlignedConfig) -> None:
        super().__init__()
        hidden = config.hidden
        self.per_view = nn.Sequential(
            nn.Linear(config.channels + GEOMETRY, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden + 1),
        )
        self.outputs = 2 * hidden + config.channels + 7

    def forward(self, views: ViewFeatures, points: Tensor) -> tuple[Tensor, Tensor]:
        """Features (B, P, outputs) of world points (B, P, 3), and their hull distance (B, P) as `hull_distance`."""
        seen = look_up(views, points)
        read = self.per_view(torch.cat([seen.features, seen.geometry], dim=-1))
        value, score = F.relu(read[..., :-1]), read[..., -1:]
        weight = torch.softmax(score + seen.framed.unsqueeze(-1).clamp(min=1e-4).log(), dim=1)
        mean = (weight * value).sum(dim=1)
        average = (weight * seen.features).sum(dim=1)
        variance = (weight * (seen.features - average.unsqueeze(1)) ** 2).sum(dim=1)
        hull = seen.distance.amin(dim=1)
        scales = [(hull / 0.03).tanh(), (hull / 0.15).tanh(), (hull / 0.5).tanh(), seen.framed.sum(dim=1) / 6.0]
        point = torch.cat([torch.stack(scales, dim=-1), points], dim=-1)
        return torch.cat([mean, value.amax(dim=1), variance, point], dim=-1), hull
