"""Pixel-aligned features: a point looks itself up in every view (PIFu, https://arxiv.org/abs/1905.05172).

Not in the paper. A triplane alone learns where things are from millions of images; a small network on a CPU gets it
from projection. For each view a point finds the coverage and the signed distance to the silhouette there, how far it
lies in front of the surface that the view shows, and image features where there are any. The views are pooled so that
their number and order do not matter. What they disagree on (the variance) tells free space from surface, and the
smallest silhouette distance is the visual hull: a start that learning carves.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...graphics.visual_hull import Outlines

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


def look_up(outlines: Outlines, maps: Tensor, points: Tensor) -> Lookup:
    """Project world points (B, P, 3) into every view and read what is there, bilinearly.

    Args:
        maps: (B, V, C + 1, h, w) image features, none if C is 0, and last the depth of the surface that the view shows,
            beyond the origin's, world units.
    """
    seen = outlines.project(points)
    found = seen.sample(maps)
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

    def __init__(self, hidden: int, features: int = 0) -> None:
        """Sizes: channels of the network that reads a point in one view, and of the image features."""
        super().__init__()
        self.per_view = nn.Sequential(
            nn.Linear(features + GEOMETRY, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden + 1),
        )
        self.outputs = 2 * hidden + features + 7

    def forward(self, outlines: Outlines, maps: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
        """What points are decoded from (B, P, outputs), and their hull distance (B, P) as `hull_distance`.

        Args:
            outlines, maps, points: as of `look_up`.
        """
        seen = look_up(outlines, maps, points)
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
