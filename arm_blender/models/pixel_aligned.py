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


@dataclass(frozen=True)
class PixelAlignedConfig:
    channels: int = 24
    """Of the convolutional features at half of the image's resolution."""
    hidden: int = 48
    """Of the network that reads a point in one view, and of each pooled feature."""
    hull_gain: float = 50.0
    """Occupancy logits for each world unit outside of the visual hull, or (a little way) inside: where learning starts.
    About 1 / temperature of the occupancy warm-up; 0 leaves the hull to be learnt from the features."""
    start_grid: int = 16
    """Points a side of the coarse volume that the plane tokens start from."""


@dataclass(frozen=True)
class ViewFeatures:
    """What points look up. B objects of V views each.

    Attributes:
        maps: (B, V, C, h, w) image features.
        depth: (B, V, 1, h, w) predicted depth of the visible surface beyond the origin's, world units.
        silhouette: (B, V, 2, H, W) coverage in [0, 1] and signed distance to the silhouette, pixels, inside positive.
        c2w: (B, V, 4, 4).
        K: (B, V, 3, 3) pixels of an image of H x W.
    """

    maps: Tensor
    depth: Tensor
    silhouette: Tensor
    c2w: Tensor
    K: Tensor


ROWS_AT_ONCE = 64
"""Bounds the distance transform's memory: 26 MB for images of 320 pixels."""


def squared_distance(occupied: Tensor) -> Tensor:
    """Exact squared Euclidean distance in pixels to the nearest occupied pixel, by two min-plus passes.

    Args:
        occupied: (V, H, W) bool.
    Returns:
        (V, H, W) float32; 1e6 where a view has no occupied pixel.
    """

    def along_rows(cost: Tensor) -> Tensor:
        steps = torch.arange(cost.shape[-1], device=cost.device, dtype=torch.float32)
        parabolas = (steps[:, None] - steps[None, :]) ** 2
        rows = [(part.unsqueeze(1) + parabolas).amin(dim=-1) for part in cost.flatten(0, 1).split(ROWS_AT_ONCE)]
        return torch.cat(rows).view_as(cost)

    cost = torch.where(occupied, 0.0, 1e6).float()
    return along_rows(along_rows(cost).transpose(1, 2)).transpose(1, 2).clamp(max=1e6)


def signed_silhouette_distance(alpha: Tensor) -> Tensor:
    """(V, H, W) signed distance in pixels to the outline alpha = 1/2, positive inside; `alpha` is (V, H, W)."""
    inside = alpha >= 0.5
    # The outline runs half a pixel beyond the centres of its pixels.
    return squared_distance(~inside).sqrt().sub(0.5).clamp(min=0.0) - squared_distance(inside).sqrt().sub(0.5).clamp(
        min=0.0
    )


class ResidualConv(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class FeaturePyramid(nn.Module):
    """A view to features and depth at half resolution; the image encoder's tokens join at a quarter."""

    INPUTS = 6

    def __init__(self, channels: int, token_width: int) -> None:
        super().__init__()
        self.to_half = nn.Sequential(nn.Conv2d(self.INPUTS, channels, 3, stride=2, padding=1), ResidualConv(channels))
        self.to_quarter = nn.Sequential(
            nn.Conv2d(channels, 2 * channels, 3, stride=2, padding=1),
            ResidualConv(2 * channels),
            ResidualConv(2 * channels),
        )
        self.from_tokens = nn.Conv2d(token_width, 2 * channels, 1)
        self.merge = nn.Sequential(
            ResidualConv(2 * channels), nn.ReLU(), nn.Conv2d(2 * channels, channels, 3, padding=1)
        )
        self.to_depth = nn.Sequential(ResidualConv(channels), nn.ReLU(), nn.Conv2d(channels, 1, 1))

    def forward(self, images: Tensor, tokens: Tensor) -> tuple[Tensor, Tensor]:
        """Features (B, C, H/2, W/2) and depth (B, 1, H/2, W/2).

        Args:
            images: (B, 6, H, W) colour, coverage, silhouette distance and size of a pixel in world units.
            tokens: (B, D, h, w).
        """
        half = self.to_half(images)
        quarter = self.to_quarter(F.relu(half))
        tokens = F.interpolate(self.from_tokens(tokens), size=quarter.shape[-2:], mode="bilinear", align_corners=False)
        merged = self.merge(quarter + tokens)
        features = half + F.interpolate(merged, size=half.shape[-2:], mode="bilinear", align_corners=False)
        return features, self.to_depth(features)


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
    batch, size = points.shape[0], views.silhouette.shape[-1]
    eye, rotation = views.c2w[..., None, :3, 3], views.c2w[..., :3, :3]
    local = (points.unsqueeze(1) - eye) @ rotation  # (B, V, P, 3)
    depth = -local[..., 2]
    near = depth.clamp(min=0.05)
    focal = views.K[..., 0, 0].unsqueeze(-1)
    x = views.K[..., 0, 2].unsqueeze(-1) + focal * local[..., 0] / near
    y = views.K[..., 1, 2].unsqueeze(-1) - views.K[..., 1, 1].unsqueeze(-1) * local[..., 1] / near
    grid = torch.stack([2.0 * x / size - 1.0, 2.0 * y / size - 1.0], dim=-1).clamp(-2.0, 2.0)  # (B, V, P, 2)

    def sampled(maps: Tensor) -> Tensor:
        taps = grid.flatten(0, 1).unsqueeze(2)
        found = F.grid_sample(maps.flatten(0, 1), taps, padding_mode="border", align_corners=False)
        return found.squeeze(-1).transpose(1, 2).unflatten(0, (batch, -1))  # (B, V, P, C)

    found = sampled(torch.cat([views.maps, views.depth], dim=2))
    features, surface = found[..., :-1], found[..., -1]
    coverage, pixels = sampled(views.silhouette).unbind(-1)
    framed = ((grid.abs().amax(dim=-1) <= 1.0) & (depth > 0.05)).float()
    distance = torch.where(framed > 0, pixels * near / focal, 0.5)
    offset = depth - views.c2w[..., :3, 3].norm(dim=-1, keepdim=True)
    ahead = surface - offset
    direction = F.normalize(-local, dim=-1) @ rotation.transpose(-1, -2)
    scalars = torch.stack(
        [
            coverage,
            (distance / 0.03).tanh(),
            (distance / 0.15).tanh(),
            (distance / 0.5).tanh(),
            framed,
            offset,
            (offset / 0.2).tanh(),
            near / focal * 50.0,
            ahead,
            (ahead / 0.04).tanh(),
            (ahead / 0.2).tanh(),
        ],
        dim=-1,
    )
    return Lookup(features, torch.cat([scalars, direction], dim=-1), framed, distance)


def hull_distance(views: ViewFeatures, points: Tensor) -> Tensor:
    """(B, P) least signed silhouette distance over the views, world units: positive inside the visual hull."""
    return look_up(views, points).distance.amin(dim=1)


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
