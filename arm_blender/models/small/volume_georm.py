"""GeoRM of `small`: outlines and colours to an occupancy whose surface is the object.

Not in the paper, whose triplanes a network of this size does not learn. A point looks itself up in every view's outline
(pixel_aligned.py), in a coarse volume over the box (feature_volume.py) and in a finer one (detail_volume.py); the
visual hull is where learning starts. At last the silhouettes are filled (graphics/silhouette_fill.py).
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from ...graphics.silhouette_fill import filled
from ...graphics.visual_hull import Outlines, hull_vote
from ...graphics.voxels import sample_volume
from ...progress import Progress, silent
from ..encoded import Encoded
from ..network_views import NetworkViews
from ..triplane import DecoderConfig, decoder
from .detail_volume import DetailVolume
from .feature_volume import FeatureVolume, object_colors
from .hull_views import HullViews
from .pixel_aligned import PointReader


@dataclass(frozen=True)
class VolumeGeoRMConfig:
    """Sizes of the network; the defaults are those of what ships, for two CPU cores."""

    image_size: int = 160
    """Pixels a side of the pictures that colours are taken from. A multiple of 8."""
    background: float = 1.0
    """Grey level (sRGB) behind the object in the pictures."""
    hull_gain: float = 50.0
    """Occupancy logits for each world unit outside of the visual hull, or (a little way) inside: where learning starts.
    About 1 / temperature of the training's occupancy; 0 leaves the hull to be learnt."""
    grid: int = 24
    """Cells a side of the coarse volume; what is thinner than a cell is left to the points' own look-up. A multiple of
    4. The time of a training step grows with its cube: 0.2 s on a core at 24, 0.7 s at 32."""
    channels: int = 24
    """Of the coarse volume's finest level; they double with each of the two coarser ones. A multiple of 4."""
    detail: int = 16
    """Channels of the finer volume, of twice the cells a side. A multiple of 4."""
    reader: int = 48
    """Channels of what reads a point in one view, and of each pooled number."""
    decoder: DecoderConfig = field(default_factory=lambda: DecoderConfig(hidden_layers=3, hidden=64))
    """Of points."""


@dataclass(frozen=True)
class EncodedVolumes(Encoded):
    """What points are decoded from.

    Attributes:
        views: where points look themselves up.
        volume: (B, C, G, G, G) coarse features.
        detail: (B, D, 2 G, 2 G, 2 G) finer ones.
    """

    views: HullViews
    volume: Tensor
    detail: Tensor

    @property
    def is_finite(self) -> bool:
        return super().is_finite and bool(self.views.depth.isfinite().all())


class VolumeGeoRM(nn.Module):
    """`encode` views once, then ask for the occupancy anywhere in the box."""

    def __init__(self, config: VolumeGeoRMConfig) -> None:
        super().__init__()
        self.config = config
        self.reader = PointReader(config.reader)
        self.volume = FeatureVolume(config.grid, config.channels)
        self.detail = DetailVolume(config.grid, config.channels, config.detail, config.hull_gain)
        # The volumes have a say past the decoder, and a loss of their own in training.
        self.coarse_vote, self.detail_vote = nn.Linear(config.channels, 1), nn.Linear(config.detail, 1)
        self.decoder = decoder(config.decoder, self.reader.outputs + config.channels + config.detail, 1)

    def encode(self, views: NetworkViews) -> EncodedVolumes:
        """Everything that points are decoded from, for B objects at once."""
        colors = object_colors(views.images.flatten(0, 1), self.config.background, self.config.image_size // 2)
        outlines = views.outlines
        return self.encode_outlines(outlines, colors.unflatten(0, views.images.shape[:2]))

    def encode_outlines(self, outlines: Outlines, colors: Tensor) -> EncodedVolumes:
        """As `encode`.

        Args:
            colors: (B, V, 4, h, w) as in `HullViews`, h = w half of the configuration's image size.
        """
        views = HullViews.of(outlines, colors)
        volume = self.volume(views)
        return EncodedVolumes(
            views, volume, self.detail(views, volume, self.coarse_vote(volume.movedim(1, -1)).movedim(-1, 1))
        )

    def occupancy_logit(self, encoded: EncodedVolumes, points: Tensor) -> Tensor:
        """(B, P) at world points (B, P, 3): positive inside, 0 on the surface.

        Close to the surface this is about the signed distance in training's units, so that linear interpolation along
        grid edges is accurate.
        """
        read, hull = self.reader(encoded.views.outlines, encoded.views.depth, points)
        cells = sample_volume(encoded.volume, points), sample_volume(encoded.detail, points)
        raw = self.decoder(torch.cat([read, *cells], dim=-1)) + self._vote(*cells)
        return raw.squeeze(-1) + hull_vote(hull, self.config.hull_gain)

    def coarse_logit(self, encoded: EncodedVolumes, points: Tensor) -> Tensor:
        """As `occupancy_logit`, by the volumes alone."""
        hull = encoded.views.outlines.hull_distance(points)
        vote = self._vote(sample_volume(encoded.volume, points), sample_volume(encoded.detail, points))
        return vote.squeeze(-1) + hull_vote(hull, self.config.hull_gain)

    def _vote(self, cell: Tensor, detail: Tensor) -> Tensor:
        return self.coarse_vote(cell) + self.detail_vote(detail)

    def filled_logit(
        self, encoded: EncodedVolumes, chunk: int, progress: Progress = silent
    ) -> Callable[[Tensor], Tensor]:
        """The field whose surface is the object: (P, 3) world points to (P,), of one object, silhouettes filled.

        Args:
            chunk: points asked at once.
            progress: of filling the silhouettes.
        """

        def plain(points: Tensor) -> Tensor:
            return self.occupancy_logit(encoded, points[None])[0]

        return filled(plain, encoded.views.outlines, chunk, progress)
