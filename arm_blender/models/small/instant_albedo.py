"""InstantAlbedo as it ships: the paper's networks correct the blend of the views, and delighting finds the light.

They predict, on a coarse atlas, how much brighter each colour is than the blend, so that sharp detail comes from the
views at full resolution and an untrained network already returns the blend.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from ...graphics.color import srgb_from_linear
from ...structures import TexelMap, TexelViews
from ...uv.maps import diffuse_fill
from ..atlas_cells import cells, enlarged, mean, scaled
from ..atlas_network import AtlasNetwork, AtlasNetworkConfig, Painted
from ..ffc import FfcConfig
from ..material_encoder import MaterialEncoderConfig
from ..unet import UnetConfig
from ..vit import VitConfig
from .delighting import Delighting, DelightingConfig, SeenPoints

BLEND_CHANNELS = 4
"""What is corrected, and where: the blend 3, the share of a cell that is covered 1."""

_LOG_GAIN = 2.5
"""Bound on the logarithm of a correction: twelve times brighter or darker."""


@dataclass(frozen=True)
class InstantAlbedoConfig(AtlasNetworkConfig):
    """Of the networks that correct the blend."""

    RETIRED: ClassVar = {"residual": True, "ablation": "none"}

    resolution: int | None = None
    """Texels a side that the networks run at at most; None is the atlas's own. Corrections are smoother than it."""
    delighting: DelightingConfig | None = None
    """Finds the light and divides it out of the blended views; None leaves that to the other networks."""


SMALL = InstantAlbedoConfig(
    encoder=MaterialEncoderConfig(
        vit=VitConfig(patch=8, dim=64, depth=4, heads=4, grid=20),
        taps=(0, 1, 2, 3),
        image_size=160,
        channels=16,
        out_channels=8,
    ),
    unet=UnetConfig(widths=(16, 32, 48), out_channels=16, stem_stride=2),
    ffc=FfcConfig(width=12, downs=3, blocks=2),
    resolution=192,
    delighting=DelightingConfig(),
)


class InstantAlbedo(AtlasNetwork):
    """Two colours per texel, with and without the lighting of the views."""

    config: InstantAlbedoConfig

    def __init__(self, config: InstantAlbedoConfig) -> None:
        super().__init__(config, BLEND_CHANNELS)
        for parameter in self.ffc.last.parameters():
            nn.init.zeros_(parameter)
        self.delighting = None if config.delighting is None else Delighting(config.delighting)

    def forward(self, images: Tensor, texels: TexelMap, seen: TexelViews, base: Tensor) -> tuple[Tensor, Tensor]:
        """Colours of the atlas.

        Args:
            images: (V, 4, H, W) linear, straight alpha: the views that `seen` was made from.
            texels: T texels a side.
            seen: of the V views.
            base: (3, T, T) linear: the blend of the views, filled where no view sees a covered texel.
        Returns:
            albedo, baked: (3, T, T) linear in [0, 1]; meaningless where no chart lies.
        Raises:
            ValueError: shapes disagree, or the resolution does not suit the networks.
        """
        albedo, baked, _ = self.painted(images, texels, seen, base)
        return albedo, baked

    def painted(self, images: Tensor, texels: TexelMap, seen: TexelViews, base: Tensor) -> Painted:
        """As `forward`, and the light that delighting finds; None where no view sees the surface."""
        side = texels.mask.shape[-1]
        surface = self.surface(images, texels, seen, base, min(side, self.config.resolution or side))
        known_base = torch.where(texels.mask, base, base.new_zeros(()))
        told = surface[:1], srgb_from_linear(mean(known_base, surface[:1]))
        predicted = self.predict(images, texels, seen, surface, told)
        gain = enlarged(_LOG_GAIN * torch.tanh(predicted / _LOG_GAIN), surface[:1], side)
        # What a view sees is the baked colour; only what no view sees is the network's to say.
        unseen = 1.0 - enlarged(mean((seen.seen & texels.mask)[None].float(), surface[:1]), surface[:1], side)
        baked = scaled(base, unseen * gain[:3])
        if self.delighting is None:
            return Painted(scaled(scaled(base, gain[:3]), gain[3:]), baked, None)
        without, light = _without_light(self.delighting, texels, seen, surface)
        return Painted(scaled(scaled(baked, without), gain[3:]), baked, light)


@torch.no_grad()
def _without_light(
    delighting: Delighting, texels: TexelMap, seen: TexelViews, surface: Tensor
) -> tuple[Tensor, Tensor | None]:
    """(3, T, T) logarithm of albedo over the views' blend, found for cells that views see and spread to the others.

    And the light (9, 3); None where no cell is seen. Not learnt from here: `fit delighting` has its own samples.
    """
    side, resolution = texels.mask.shape[-1], surface.shape[-1]
    share = torch.cat([cells(visible[None].float(), resolution) for visible in seen.visibility])  # (V, n, n)
    covered, known = surface[0] > 0.0, share.amax(dim=0) > 0.0
    gain = surface.new_zeros(3, resolution, resolution)
    if not bool(known.any()):
        return gain.new_zeros(3, side, side), None
    color = torch.stack([mean(c, s[None])[:, known].T for c, s in zip(seen.color, share, strict=True)])
    normal = functional.normalize(surface[4:, known].T, dim=1)
    points = (surface[1:4, known].T, normal, color, share[:, known] > 0.0, seen.eyes)
    of_points, light = delighting.log_gain(SeenPoints(*(part[None] for part in points)))
    gain[:, known] = of_points.T
    gain = diffuse_fill(gain, known, TexelMap(surface[1:4], surface[4:], covered))
    return enlarged(gain, surface[:1], side), light
