"""The InstantAlbedo that ships with a part left out or replaced, to see what it is for (ARM, section 6, supplement)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor, nn

from arm_blender import networks
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.models.atlas_cells import enlarged
from arm_blender.models.atlas_network import FUSED_CHANNELS, AtlasNetwork
from arm_blender.models.small.instant_albedo import BLEND_CHANNELS, SMALL, InstantAlbedo, InstantAlbedoConfig
from arm_blender.models.unet import Unet
from arm_blender.structures import TexelMap, TexelViews

from ..options import TrainerConfig
from ..run_record import RunRecord
from ..stages import instant_albedo
from ..stages.instant_albedo_start import Start

WHOLE = "none"
"""What the network with all its parts leaves out."""


@dataclass(frozen=True)
class AblatedConfig(InstantAlbedoConfig):
    """Of a network that lacks a part; weights fit no other choice."""

    ablation: str = ""
    """A key of `ABLATIONS`."""


class CoarseColors(AtlasNetwork):
    """Colours of the coarse atlas, enlarged: corrections of the blend would let its detail in again."""

    config: InstantAlbedoConfig

    def forward(self, images: Tensor, texels: TexelMap, seen: TexelViews, base: Tensor) -> tuple[Tensor, Tensor]:
        """As of `InstantAlbedo`; `base` has no say."""
        side = texels.mask.shape[-1]
        surface = self.surface(images, texels, seen, base, min(side, self.config.resolution or side))
        colors = linear_from_srgb(torch.sigmoid(self.predict(images, texels, seen, surface)))
        colors = enlarged(colors, surface[:1], side)
        return colors[3:], colors[:3]


class NoMeasurements(CoarseColors):
    """Sees all about a view but its colours, and predicts colours, for the blend holds them."""

    def forward(self, images: Tensor, texels: TexelMap, seen: TexelViews, base: Tensor) -> tuple[Tensor, Tensor]:
        """As of `InstantAlbedo`."""
        return super().forward(images, texels, replace(seen, color=torch.zeros_like(seen.color)), base)


class NoMaterialEncoder(InstantAlbedo):
    """Nothing reads the views for material."""

    def __init__(self, config: AblatedConfig) -> None:
        super().__init__(config)
        self.encoder = _Nothing(config.encoder.out_channels)


class LocalUnet(InstantAlbedo):
    """A U-Net completes the atlas, which sees no farther than its levels, in the place of FFC-Net."""

    def __init__(self, config: AblatedConfig) -> None:
        super().__init__(config)
        channels = config.unet.out_channels + FUSED_CHANNELS + BLEND_CHANNELS
        self.ffc = Unet(channels, replace(config.unet, out_channels=6, stem_stride=1))
        for parameter in self.ffc.last.parameters():
            nn.init.zeros_(parameter)


class _Nothing(nn.Module):
    """Features of a picture that say nothing."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.channels = channels

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, H, W) -> (B, C, H, W)."""
        return images.new_zeros(len(images), self.channels, *images.shape[-2:])


ABLATIONS: dict[str, Callable[[AblatedConfig], nn.Module]] = {
    "no-measurements": NoMeasurements,
    "no-material-encoder": NoMaterialEncoder,
    "local-unet": LocalUnet,
    "no-super-resolution": CoarseColors,
}


def ablated(config: AblatedConfig) -> nn.Module:
    """The network that the config is of."""
    return ABLATIONS[config.ablation](config)


def register() -> None:
    """Have the pipeline, which knows nothing of ablations, run their weights in this process."""
    networks.NETWORKS["instant_albedo"][AblatedConfig] = ablated


def without(config: InstantAlbedoConfig, ablation: str) -> InstantAlbedoConfig:
    """The config without a part, and always without delighting, which has weights of its own."""
    if ablation == WHOLE:
        return replace(config, delighting=None)
    return AblatedConfig(config.encoder, config.unet, config.ffc, config.resolution, None, ablation)


def fit(ablation: str, cache: Path, output: Path, config: TrainerConfig, views: int) -> None:
    """Fit the network without a part, or with all for `WHOLE`, from scratch, to the samples in `cache`.

    Raises:
        ArmError: there are no samples.
    """
    samples, settings = instant_albedo.Samples(cache), instant_albedo.FitConfig(views=views)
    record = RunRecord.beside(output, {"ablation": ablation, "views": views, "steps": config.steps})
    instant_albedo.fit(Start(without(SMALL, ablation)), samples, output, config, settings, record)
