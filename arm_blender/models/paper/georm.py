"""GeoRM: views to a density whose iso-surface is the object (ARM, section 5.1)."""

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

from ...progress import Progress, silent
from ..network_views import NetworkViews
from .reconstruction import EncodedPlanes, ReconstructionConfig, ReconstructionModel

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

    def encode(self, views: NetworkViews) -> EncodedPlanes:
        """Everything that points are decoded from."""
        return self.model.encode(views)

    def occupancy_logit(self, encoded: EncodedPlanes, points: Tensor) -> Tensor:
        """(B, P) raw value over the iso value at world points (B, P, 3): positive inside, 0 on the surface.

        Close to the surface this is about the signed distance in training's units, so that linear interpolation along
        grid edges is accurate; the density itself, softplus of it, bends there.
        """
        return self.model.decode(encoded, points).squeeze(-1)

    def filled_logit(
        self, encoded: EncodedPlanes, chunk: int, progress: Progress = silent
    ) -> Callable[[Tensor], Tensor]:
        """The field whose surface is the object: (P, 3) world points to (P,), of one object.

        Silhouettes are left as they come out: of the views these planes know no outlines.
        """
        del chunk, progress
        return lambda points: self.occupancy_logit(encoded, points[None])[0]

    def density(self, encoded: EncodedPlanes, points: Tensor) -> Tensor:
        """(B, P) volume density >= 0 at world points (B, P, 3); `ISO_DENSITY` on the surface."""
        return torch.nn.functional.softplus(self.occupancy_logit(encoded, points) + RAW_ISO - 1.0)
