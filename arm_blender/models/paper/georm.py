"""GeoRM: views to a density whose iso-surface is the object (ARM, section 5.1)."""

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

from ...graphics.silhouette_fill import filled
from ...graphics.visual_hull import hull_vote
from ...progress import Progress, silent
from ..network_views import NetworkViews
from .reconstruction import EncodedViews, ReconstructionConfig, ReconstructionModel

ISO_DENSITY = 10.0
"""Density at the surface; unstated in the paper, 10 is InstantMesh's, as is the softplus."""

RAW_ISO = 1.0 + math.log(math.expm1(ISO_DENSITY))
"""The raw value whose density, softplus(raw - 1), is `ISO_DENSITY`."""


class GeoRM(nn.Module):
    """`encode` views once, then ask for the density anywhere in the box."""

    def __init__(self, config: ReconstructionConfig) -> None:
        super().__init__()
        self.config = config
        self.model = ReconstructionModel(config, outputs=1)

    def encode(self, views: NetworkViews) -> EncodedViews:
        """Everything that points are decoded from."""
        return self.model.encode(views)

    def occupancy_logit(self, encoded: EncodedViews, points: Tensor) -> Tensor:
        """(B, P) raw value over the iso value at world points (B, P, 3): positive inside, 0 on the surface.

        Close to the surface this is about the signed distance in training's units, so that linear interpolation along
        grid edges is accurate; the density itself, softplus of it, bends there.
        """
        raw, hull = self.model.decode(encoded, points)
        return raw.squeeze(-1) if hull is None else raw.squeeze(-1) + self._hull_vote(hull)

    def filled_logit(
        self, encoded: EncodedViews, chunk: int, progress: Progress = silent
    ) -> Callable[[Tensor], Tensor]:
        """The field whose surface is the object: (P, 3) world points to (P,), of one object, silhouettes filled.

        Where the configuration has no outlines it is `occupancy_logit`.

        Args:
            chunk: points asked at once.
            progress: of filling the silhouettes.
        """

        def plain(points: Tensor) -> Tensor:
            return self.occupancy_logit(encoded, points[None])[0]

        if encoded.views is None:
            return plain
        return filled(plain, encoded.views.outlines, chunk, progress)

    def coarse_logit(self, encoded: EncodedViews, points: Tensor) -> Tensor:
        """As `occupancy_logit`, by the feature volumes alone."""
        hull = encoded.views.outlines.hull_distance(points)
        return self.model.decode_coarse(encoded, points).squeeze(-1) + self._hull_vote(hull)

    def _hull_vote(self, hull: Tensor) -> Tensor:
        return hull_vote(hull, self.config.pixel_aligned.hull_gain)

    def density(self, encoded: EncodedViews, points: Tensor) -> Tensor:
        """(B, P) volume density >= 0 at world points (B, P, 3); `ISO_DENSITY` on the surface."""
        return torch.nn.functional.softplus(self.occupancy_logit(encoded, points) + RAW_ISO - 1.0)
