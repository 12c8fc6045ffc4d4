"""GlossyRM: views to roughness and metallic over the surface (ARM, section 5.1).

The architecture of GeoRM, and its weights to start from; decoded per texel at inference, per vertex in training.
"""

from torch import Tensor, nn

from ..network_views import NetworkViews
from .reconstruction import EncodedPlanes, ReconstructionConfig, ReconstructionModel


class GlossyRM(nn.Module):
    """`encode` views once, then ask for roughness and metallic at surface points.

    The paper does not say what bounds the two: a sigmoid does.
    """

    def __init__(self, config: ReconstructionConfig) -> None:
        super().__init__()
        self.config = config
        self.model = ReconstructionModel(config, outputs=2)

    def encode(self, views: NetworkViews) -> EncodedPlanes:
        """Everything that points are decoded from."""
        return self.model.encode(views)

    def forward(self, encoded: EncodedPlanes, points: Tensor) -> Tensor:
        """(B, P, 2) roughness and metallic in (0, 1) at world points (B, P, 3)."""
        return self.model.decode(encoded, points).sigmoid()

    def load_geometry(self, weights: dict[str, Tensor]) -> None:
        """Start from GeoRM's weights: all but the last layer, whose outputs mean something else."""
        last = f"model.decoder.{len(self.model.decoder) - 1}."
        own = {key: value for key, value in self.state_dict().items() if key.startswith(last)}
        self.load_state_dict(weights | own)
