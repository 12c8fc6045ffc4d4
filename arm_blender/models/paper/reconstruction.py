"""The large reconstruction model that GeoRM and GlossyRM share: views to a field over the box (ARM, section 5.1)."""

from dataclasses import dataclass, field
from typing import Literal

from torch import Tensor, nn

from ...graphics.cameras import front_on_x
from ..encoded import Encoded
from ..image_encoder import ImageEncoder, ImageEncoderConfig, camera_embedding
from ..network_views import NetworkViews
from ..transformer import TransformerConfig, TriplaneTransformer
from ..triplane import DecoderConfig, Upsampler, UpsamplerConfig, decoder, sample_planes


@dataclass(frozen=True)
class ReconstructionConfig:
    """All parts of the model; the defaults are the paper's."""

    encoder: ImageEncoderConfig = field(default_factory=ImageEncoderConfig)
    transformer: TransformerConfig = field(default_factory=TransformerConfig)
    upsampler: UpsamplerConfig = field(default_factory=UpsamplerConfig)
    decoder: DecoderConfig = field(default_factory=DecoderConfig)
    background: float = 1.0
    """Grey level (sRGB) behind the object in the network's input; InstantMesh's encoder knows white."""
    front: Literal["-y", "+x"] = "-y"
    """Where azimuth 0 stands in the network's own frame. With the wrong one it meets cameras that it has never seen;
    InstantMesh's is +x."""

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


@dataclass(frozen=True)
class EncodedPlanes(Encoded):
    """What points are decoded from: planes (B, 3, C, R, R)."""

    planes: Tensor


class ReconstructionModel(nn.Module):
    """Views to triplane; points of the triplane to `outputs` raw numbers."""

    def __init__(self, config: ReconstructionConfig, outputs: int) -> None:
        super().__init__()
        self.config = config
        self.encoder = ImageEncoder(config.encoder)
        self.transformer = TriplaneTransformer(config.transformer, config.encoder.width)
        self.upsampler = Upsampler(config.upsampler, config.transformer.width)
        self.decoder = decoder(config.decoder, 3 * config.upsampler.channels, outputs)

    def encode(self, views: NetworkViews) -> EncodedPlanes:
        """Everything that points are decoded from, for B objects at once."""
        batch = len(views.images)
        c2w = front_on_x(views.c2w, dim=-2) if self.config.front == "+x" else views.c2w
        cameras = camera_embedding(c2w, views.K, views.silhouette.shape[-1]).flatten(0, 1)
        tokens = self.encoder(views.images.flatten(0, 1)[:, :3], cameras)  # (B * V, L, D)
        coarse = self.transformer(tokens.reshape(batch, -1, tokens.shape[-1]))  # (B, 3, D, R, R)
        return EncodedPlanes(self.upsampler(coarse.flatten(0, 1)).unflatten(0, (batch, 3)))

    def decode(self, encoded: EncodedPlanes, points: Tensor) -> Tensor:
        """Raw values (B, P, outputs) at world points (B, P, 3)."""
        own = front_on_x(points, dim=-1) if self.config.front == "+x" else points
        return self.decoder(sample_planes(encoded.planes, own))
