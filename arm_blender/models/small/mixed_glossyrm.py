"""GlossyRM of `small`: roughness and metallic by the paper's triplanes and by what points look up in the views.

Triplane transformer, feature pyramid, feature volume and pixel-aligned look-up all have a say in what it answers, which
is nearly a constant (docs/training-log.md): the network is as it was trained, and nothing trains it further.
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...graphics.visual_hull import Outlines
from ...graphics.voxels import cell_centers, sample_volume
from ..encoded import Encoded
from ..image_encoder import ImageEncoder, ImageEncoderConfig, camera_embedding
from ..network_views import NetworkViews
from ..transformer import TransformerConfig, TriplaneTransformer
from ..triplane import DecoderConfig, Upsampler, UpsamplerConfig, decoder, sample_planes
from .feature_pyramid import FeaturePyramid
from .feature_volume import GEOMETRY, VolumeUnet, cell_geometry
from .hull_views import hull_buffer
from .pixel_aligned import PointReader


@dataclass(frozen=True)
class MixedGlossyRMConfig:
    """Sizes of the network's parts; the defaults are those of what ships."""

    encoder: ImageEncoderConfig = field(
        default_factory=lambda: ImageEncoderConfig(
            image_size=160, position_grid=10, width=96, depth=3, heads=6, mean=(0.5,) * 3, std=(0.5,) * 3
        )
    )
    transformer: TransformerConfig = field(
        default_factory=lambda: TransformerConfig(width=96, layers=3, heads=6, grid=16)
    )
    upsampler: UpsamplerConfig = field(
        default_factory=lambda: UpsamplerConfig(filters=48, blocks=1, growth=16, doublings=2, channels=16)
    )
    decoder: DecoderConfig = field(default_factory=lambda: DecoderConfig(hidden_layers=3, hidden=64))
    features: int = 24
    """Channels of the feature pyramid, at half of the images' resolution."""
    reader: int = 48
    """Channels of what reads a point in one view, and of each pooled number."""
    grid: int = 24
    """Cells a side of the volume. A multiple of 4."""
    channels: int = 16
    """Of the volume's finest level. A multiple of 4."""
    background: float = 1.0
    """Grey level (sRGB) behind the object in the network's input."""

    @property
    def image_size(self) -> int:
        """Pixels a side of the images."""
        return self.encoder.image_size


@dataclass(frozen=True)
class EncodedMixture(Encoded):
    """What points are decoded from.

    Attributes:
        planes: (B, 3, C, R, R).
        outlines: of the views, where points are found.
        maps: (B, V, F + 1, h, w) image features, and last the depth that each view shows (`pixel_aligned.look_up`).
        volume: (B, D, G, G, G).
    """

    planes: Tensor
    outlines: Outlines
    maps: Tensor
    volume: Tensor


class PooledVolume(VolumeUnet):
    """Views' features and depths to a volume (B, C, G, G, G) over the box."""

    def __init__(self, grid: int, channels: int, features: int) -> None:
        super().__init__(2 * features + GEOMETRY, channels)
        self.grid = grid

    def forward(self, outlines: Outlines, maps: Tensor) -> Tensor:
        """The refined volume, indexed z, y, x; `maps` as in `EncodedMixture`."""
        points = cell_centers(self.grid, maps.device).expand(len(maps), -1, -1)
        seen = outlines.project(points)
        found = seen.sample(maps)
        features, surface = found[..., :-1], found[..., -1]
        _, distance = outlines.read(seen)
        front = surface - (seen.depth - outlines.range.unsqueeze(-1))
        weight = seen.framed.unsqueeze(-1)
        total = weight.sum(dim=1).clamp(min=1.0)
        mean = (weight * features).sum(dim=1) / total
        variance = (weight * (features - mean.unsqueeze(1)) ** 2).sum(dim=1) / total
        geometry = cell_geometry(distance, front, seen.framed, total.squeeze(-1))
        cells = torch.cat([mean, variance, geometry, points], dim=-1)
        return self.refine(cells.transpose(1, 2).unflatten(-1, (self.grid,) * 3))


class MixedGlossyRM(nn.Module):
    """`encode` views once, then ask for roughness and metallic at surface points."""

    def __init__(self, config: MixedGlossyRMConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = ImageEncoder(config.encoder)
        self.transformer = TriplaneTransformer(config.transformer, config.encoder.width)
        self.upsampler = Upsampler(config.upsampler, config.transformer.width)
        self.pyramid = FeaturePyramid(config.features, config.encoder.width)
        self.reader = PointReader(config.reader, config.features)
        self.volume = PooledVolume(config.grid, config.channels, config.features)
        self.start = nn.Linear(2 * config.channels, config.transformer.width)
        inputs = 3 * config.upsampler.channels + self.reader.outputs + config.channels
        self.decoder = decoder(config.decoder, inputs, 2)

    def encode(self, views: NetworkViews) -> EncodedMixture:
        """Everything that points are decoded from, for B objects at once."""
        batch = len(views.images)
        images = views.images.flatten(0, 1)  # (B * V, 4, S, S)
        cameras = camera_embedding(views.c2w, views.K, views.silhouette.shape[-1]).flatten(0, 1)
        tokens = self.encoder(images[:, :3], cameras)  # (B * V, L, D)
        outlines = views.outlines
        maps = self.view_maps(views, outlines, tokens)
        volume = self.volume(outlines, maps)
        context = tokens.reshape(batch, -1, tokens.shape[-1])
        coarse = self.transformer(context, self.starting_tokens(volume))  # (B, 3, D, R, R)
        planes = self.upsampler(coarse.flatten(0, 1)).unflatten(0, (batch, 3))
        return EncodedMixture(planes, outlines, maps, volume)

    def view_maps(self, views: NetworkViews, outlines: Outlines, tokens: Tensor) -> Tensor:
        """What points look up in the views, as in `EncodedMixture`.

        Args:
            tokens: (B * V, L, D) of the image encoder, CLS first.
        """
        images = views.images.flatten(0, 1)
        grid = images.shape[-1] // self.config.encoder.patch_size
        patches = tokens[:, 1:].transpose(1, 2).unflatten(-1, (grid, grid))
        # At the origin's depth: how long a pixel is, and with it the silhouette distance, in world units.
        length = (outlines.range / views.K[..., 0, 0]).flatten()[:, None, None, None]
        pixels = F.interpolate(
            views.silhouette[:, :, 1:].flatten(0, 1), size=images.shape[-2:], mode="bilinear", align_corners=False
        )
        metric = torch.cat([(pixels * length / 0.2).tanh(), (50.0 * length).expand_as(pixels)], dim=1)
        hull = hull_buffer(outlines, images.shape[-1] // 2).flatten(0, 1)
        found = self.pyramid(torch.cat([images, metric], dim=1), patches, hull)
        return torch.cat(found, dim=1).unflatten(0, views.images.shape[:2])

    def starting_tokens(self, volume: Tensor) -> Tensor:
        """What the plane tokens start from: (B, 3 * R * R, D)."""
        batch, width = volume.shape[0], self.config.transformer.width
        columns = F.interpolate(
            plane_columns(volume).flatten(0, 1), size=(self.config.transformer.grid,) * 2, mode="area"
        )
        return self.start(columns.flatten(2).transpose(1, 2)).reshape(batch, -1, width)

    def forward(self, encoded: EncodedMixture, points: Tensor) -> Tensor:
        """(B, P, 2) roughness and metallic in (0, 1) at world points (B, P, 3)."""
        read, _ = self.reader(encoded.outlines, encoded.maps, points)
        parts = [sample_planes(encoded.planes, points), read, sample_volume(encoded.volume, points)]
        return self.decoder(torch.cat(parts, dim=-1)).sigmoid()


def plane_columns(volume: Tensor) -> Tensor:
    """Mean and maximum along each plane's normal: (B, 3, 2 * C, G, G), planes and axes as `triplane.sample_planes`."""
    columns = (volume, volume.transpose(2, 3), volume.permute(0, 1, 4, 3, 2))  # The normal first: z, y, x.
    pooled = [torch.cat([v.mean(dim=2), v.amax(dim=2)], dim=1) for v in columns]
    # After taking the normal away: (y, x), (z, x) and (y, z); rows are the plane's second coordinate.
    return torch.stack(pooled, dim=1)
