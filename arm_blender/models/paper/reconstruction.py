"""The large reconstruction model that GeoRM and GlossyRM share: views to a field over the box (ARM, section 5.1).

`config.pixel_aligned` is None in the paper's configuration; `small` adds it (see pixel_aligned.py).
"""

from dataclasses import dataclass, field, replace
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...graphics.cameras import front_on_x
from ...graphics.visual_hull import Outlines
from ...graphics.voxels import sample_volume
from ..image_encoder import ImageEncoder, ImageEncoderConfig, camera_embedding
from ..network_views import NetworkViews
from ..small.detail_volume import DetailVolume
from ..small.feature_volume import FeatureVolume, FeatureVolumeConfig, object_colors, plane_columns
from ..small.pixel_aligned import FeaturePyramid, PixelAlignedConfig, PointReader, ViewFeatures
from ..transformer import TransformerConfig, TriplaneTransformer
from ..triplane import DecoderConfig, Upsampler, UpsamplerConfig, decoder, sample_planes


@dataclass(frozen=True)
class ReconstructionConfig:
    """All parts of the model; the defaults are the paper's."""

    encoder: ImageEncoderConfig = field(default_factory=ImageEncoderConfig)
    transformer: TransformerConfig = field(default_factory=TransformerConfig)
    upsampler: UpsamplerConfig = field(default_factory=UpsamplerConfig)
    decoder: DecoderConfig = field(default_factory=DecoderConfig)
    pixel_aligned: PixelAlignedConfig | None = None
    volume: FeatureVolumeConfig | None = None
    """Comes with `pixel_aligned`; None in the paper's configuration."""
    background: float = 1.0
    """Grey level (sRGB) behind the object in the network's input; InstantMesh's encoder knows white."""
    front: Literal["-y", "+x"] = "-y"
    """Where azimuth 0 stands in the network's own frame. With the wrong one it meets cameras that it has never seen;
    InstantMesh's is +x."""

    def __post_init__(self) -> None:
        if self.pixel_aligned and self.front != "-y":
            raise ValueError(f"front {self.front}: pixel-aligned features live in the world's frame, give -y")

    @property
    def image_size(self) -> int:
        """Pixels a side of the images."""
        return self.encoder.image_size


PAPER = ReconstructionConfig()
"""The paper's table 4, and reference facts where it is silent."""

INSTANTMESH = ReconstructionConfig(
    upsampler=UpsamplerConfig(deconvolution=True), decoder=DecoderConfig(hidden_layers=3, hidden=64), front="+x"
)
"""What InstantMesh's weights need: its decoder and frame, and its deconvolution beneath the paper's upsampler. The mean
and deviation of its images are those that DINO was trained with; InstantMesh reads its own from a file not at hand."""

SMALL = ReconstructionConfig(
    encoder=ImageEncoderConfig(
        image_size=160, position_grid=10, width=96, depth=3, heads=6, mean=(0.5,) * 3, std=(0.5,) * 3
    ),
    transformer=TransformerConfig(width=96, layers=3, heads=6, grid=16),
    upsampler=UpsamplerConfig(filters=48, blocks=1, growth=16, doublings=2, channels=16),
    decoder=DecoderConfig(hidden_layers=3, hidden=64),
    pixel_aligned=PixelAlignedConfig(normed=True),
    volume=FeatureVolumeConfig(channels=24, hidden=0.2, votes=True, colors=True, detail=16),
)
"""The same modules, sized for two CPU cores, with pixel-aligned features: GeoRM's."""

SMALL_GLOSSY = replace(SMALL, volume=replace(SMALL.volume, detail=0))
"""GlossyRM's: where exactly the surface is, it is told by the mesh."""

SMALL_TRIPLANE = replace(SMALL, pixel_aligned=None, volume=None)
"""The paper's form at the size of `small`, for an ablation: without volumes and hull, which read those features."""


@dataclass(frozen=True)
class EncodedViews:
    """What points are decoded from.

    Attributes:
        planes: (B, 3, C, R, R).
        views: pixel-aligned features, or None in the paper's configuration.
        volume: (B, C, G, G, G) coarse features, or None with `views`.
        detail: (B, D, 2 G, 2 G, 2 G) finer ones, or None.
    """

    planes: Tensor
    views: ViewFeatures | None
    volume: Tensor | None
    detail: Tensor | None = None

    @property
    def is_finite(self) -> bool:
        """Whether all of it are numbers."""
        read = () if self.views is None else (self.views.maps, self.views.depth)
        given = (x for x in (self.planes, self.volume, self.detail, *read) if x is not None)
        return all(bool(x.isfinite().all()) for x in given)

    def float(self) -> "EncodedViews":
        """The same in float32: what an encoding under autocast is decoded from."""
        views = self.views and replace(self.views, maps=self.views.maps.float(), depth=self.views.depth.float())
        volume, detail = (None if x is None else x.float() for x in (self.volume, self.detail))
        return EncodedViews(self.planes.float(), views, volume, detail)


class ReconstructionModel(nn.Module):
    """Views to triplane; points of the triplane to `outputs` raw numbers."""

    def __init__(self, config: ReconstructionConfig, outputs: int) -> None:
        super().__init__()
        self.config = config
        self.encoder = ImageEncoder(config.encoder)
        self.transformer = TriplaneTransformer(config.transformer, config.encoder.width)
        self.upsampler = Upsampler(config.upsampler, config.transformer.width)
        inputs = 3 * config.upsampler.channels
        if config.pixel_aligned:
            self.pyramid = FeaturePyramid(
                config.pixel_aligned.channels, config.encoder.width, config.pixel_aligned.normed
            )
            self.reader = PointReader(config.pixel_aligned)
            self.volume = FeatureVolume(config.volume, config.pixel_aligned.channels)
            self.start = nn.Linear(2 * config.volume.channels, config.transformer.width)
            cells = config.volume.channels + config.volume.detail
            inputs += self.reader.outputs + cells
            self.coarse = nn.Linear(config.volume.channels, outputs) if config.volume.votes else None
            if config.volume.detail:
                self.detail = DetailVolume(config.volume, config.pixel_aligned.hull_gain)
                self.detail_vote = nn.Linear(config.volume.detail, outputs)
        self.decoder = decoder(config.decoder, inputs, outputs)

    def encode(self, views: NetworkViews) -> EncodedViews:
        """Everything that points are decoded from, for B objects at once."""
        batch = len(views.images)
        tokens, features = self.look(views)
        volume = self.volume(features) if features else None
        start = self.starting_tokens(volume) if features else None
        coarse = self.transformer(tokens.reshape(batch, -1, tokens.shape[-1]), start)  # (B, 3, D, R, R)
        planes = self.upsampler(coarse.flatten(0, 1)).unflatten(0, (batch, 3))
        return EncodedViews(planes, features, volume, self.refined(features, volume))

    def refined(self, features: ViewFeatures | None, volume: Tensor | None) -> Tensor | None:
        """The detail volume, where the configuration has one; the coarse vote is then an occupancy's logit."""
        if not (self.config.volume and self.config.volume.detail):
            return None
        return self.detail(features, volume, self.coarse(volume.movedim(1, -1)).movedim(-1, 1))

    def look(self, views: NetworkViews) -> tuple[Tensor, ViewFeatures | None]:
        """What is found in each view by itself: (B * V, L, D) tokens, and the pixel-aligned features if there are."""
        images = views.images.flatten(0, 1)  # (B * V, 4, S, S)
        c2w = front_on_x(views.c2w, dim=-2) if self.config.front == "+x" else views.c2w
        cameras = camera_embedding(c2w, views.K, views.silhouette.shape[-1]).flatten(0, 1)
        tokens = self.encoder(images[:, :3], cameras)
        return tokens, self.view_features(views, images, tokens) if self.config.pixel_aligned else None

    def view_features(self, views: NetworkViews, images: Tensor, tokens: Tensor) -> ViewFeatures:
        """What points look up in the views.

        Args:
            images: (B * V, 4, S, S), those of `views`.
            tokens: (B * V, L, D) of the image encoder, CLS first.
        """
        grid = images.shape[-1] // self.config.encoder.patch_size
        patches = tokens[:, 1:].transpose(1, 2).unflatten(-1, (grid, grid))
        outlines = Outlines(views.silhouette, views.c2w, views.K)
        # At the origin's depth: how long a pixel is, and with it the silhouette distance, in world units.
        length = (outlines.range / views.K[..., 0, 0]).flatten()[:, None, None, None]
        pixels = F.interpolate(
            views.silhouette[:, :, 1:].flatten(0, 1), size=images.shape[-2:], mode="bilinear", align_corners=False
        )
        metric = torch.cat([(pixels * length / 0.2).tanh(), (50.0 * length).expand_as(pixels)], dim=1)
        side = images.shape[-1]
        # A quarter of the resolution is enough: the hull is smooth between the views' outlines.
        hull = F.interpolate(outlines.hull_depth(side // 4).flatten(0, 1), scale_factor=2, mode="nearest")
        maps, depth = self.pyramid(torch.cat([images, metric], dim=1), patches, hull)
        shape = views.images.shape[:2]
        colors = None
        if self.config.volume.colors:
            smaller = self.config.volume.color_side(side)
            colors = object_colors(images, self.config.background, smaller).unflatten(0, shape)
        return ViewFeatures(maps.unflatten(0, shape), depth.unflatten(0, shape), outlines, colors)

    def starting_tokens(self, volume: Tensor) -> Tensor:
        """What the plane tokens start from: (B, 3 * R * R, D)."""
        batch, width = volume.shape[0], self.config.transformer.width
        columns = F.interpolate(
            plane_columns(volume).flatten(0, 1), size=(self.config.transformer.grid,) * 2, mode="area"
        )
        return self.start(columns.flatten(2).transpose(1, 2)).reshape(batch, -1, width)

    def decode(self, encoded: EncodedViews, points: Tensor) -> tuple[Tensor, Tensor | None]:
        """Raw values at world points.

        Args:
            points: (B, P, 3).
        Returns:
            (B, P, outputs), and the points' hull distance (B, P) where the configuration is pixel-aligned.
        """
        own = front_on_x(points, dim=-1) if self.config.front == "+x" else points
        features = sample_planes(encoded.planes, own)
        if encoded.views is None:
            return self.decoder(features), None
        read, hull = self.reader(encoded.views, points)
        parts = [features, read, sample_volume(encoded.volume, points)]
        if encoded.detail is not None:
            parts.append(sample_volume(encoded.detail, points))
        raw = self.decoder(torch.cat(parts, dim=-1))
        return raw if self.coarse is None else raw + self._vote(*parts[2:]), hull

    def decode_coarse(self, encoded: EncodedViews, points: Tensor) -> Tensor:
        """The volumes' own vote on the raw values, (B, P, outputs) at world points (B, P, 3)."""
        volumes = [x for x in (encoded.volume, encoded.detail) if x is not None]
        return self._vote(*(sample_volume(volume, points) for volume in volumes))

    def _vote(self, cell: Tensor, detail: Tensor | None = None) -> Tensor:
        vote = self.coarse(cell)
        return vote if detail is None else vote + self.detail_vote(detail)
