"""InstantAlbedo as published (ARM, section 5.2 and supplement): both colours of every texel, by the network alone."""

import torch
from torch import Tensor

from ...graphics.color import linear_from_srgb
from ...structures import TexelMap, TexelViews
from ..atlas_network import AtlasNetwork, AtlasNetworkConfig

PAPER = AtlasNetworkConfig()


class PaperInstantAlbedo(AtlasNetwork):
    """Two colours per texel, with and without the lighting of the views."""

    def forward(self, images: Tensor, texels: TexelMap, seen: TexelViews, base: Tensor) -> tuple[Tensor, Tensor]:
        """Colours of the atlas, as of `small.instant_albedo`; `base` has no say."""
        surface = self.surface(images, texels, seen, base, texels.mask.shape[-1])
        colors = linear_from_srgb(torch.sigmoid(self.predict(images, texels, seen, surface)))
        return colors[3:], colors[:3]
