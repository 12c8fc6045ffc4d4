"""What both InstantAlbedos are made of (ARM, section 5.2 and supplement): from what views say of an atlas to its cells.

    per-view texels + material features --U-Net--> features --max over views--> fused --FFC-Net--> six numbers a cell

The networks see sRGB; colours are linear at both ends.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..graphics.color import composite, srgb_from_linear
from ..structures import TexelMap, TexelViews
from .atlas_cells import cells, mean, resized, surface_cells
from .ffc import FfcConfig, FfcGenerator
from .material_encoder import MaterialEncoder, MaterialEncoderConfig
from .unet import Unet, UnetConfig

_VIEW_CHANNELS = 15
"""Image 3, mask 1, position 3, texture coordinates 2, view direction 3, normal 3."""

FUSED_CHANNELS = 7
"""Beside the fused features: any-seen mask 1, position 3, normal 3."""


@dataclass(frozen=True)
class AtlasNetworkConfig:
    """The paper's networks; where it is silent, docs of the parts say what was chosen."""

    encoder: MaterialEncoderConfig = MaterialEncoderConfig()
    """Reads the views for material, back-projected like their colours."""
    unet: UnetConfig = UnetConfig()
    """Reads each view's texels."""
    ffc: FfcConfig = FfcConfig()
    """Completes the fused atlas."""

    @property
    def multiple(self) -> int:
        """The networks' resolution is a multiple of this."""
        return max(self.unet.multiple, 2**self.ffc.downs)


class Painted(NamedTuple):
    """Colours of an atlas.

    Attributes:
        albedo, baked: (3, T, T) linear in [0, 1]; meaningless where no chart lies.
        light: (9, 3) of the views, as of `spherical_harmonics.gathered`; None where none was found.
    """

    albedo: Tensor
    baked: Tensor
    light: Tensor | None


class AtlasNetwork(nn.Module):
    """Encoder, U-Net and FFC-Net; what their numbers mean is said by who inherits.

    Args:
        told: channels of what `predict` is told besides.
    """

    def __init__(self, config: AtlasNetworkConfig, told: int = 0) -> None:
        super().__init__()
        self.config = config
        self.encoder: nn.Module = MaterialEncoder(config.encoder)
        self.unet = Unet(_VIEW_CHANNELS + config.encoder.out_channels, config.unet)
        self.ffc: FfcGenerator | Unet = FfcGenerator(config.unet.out_channels + FUSED_CHANNELS + told, 6, config.ffc)

    def painted(self, images: Tensor, texels: TexelMap, seen: TexelViews, base: Tensor) -> Painted:
        """What `forward` says, which see, and the light where the network finds one."""
        albedo, baked = self(images, texels, seen, base)
        return Painted(albedo, baked, None)

    def surface(self, images: Tensor, texels: TexelMap, seen: TexelViews, base: Tensor, resolution: int) -> Tensor:
        """(7, n, n) the cells that the networks run on, n the resolution: share covered, position, normal.

        Raises:
            ValueError: shapes disagree, or the resolution does not suit the networks.
        """
        side = texels.mask.shape[-1]
        if resolution % self.config.multiple:
            raise ValueError(f"resolution {resolution} is no multiple of {self.config.multiple}")
        if base.shape != (3, side, side) or len(images) != len(seen.visibility):
            raise ValueError(f"{len(images)} images, {len(seen.visibility)} views, base {tuple(base.shape)}, T {side}")
        return surface_cells(texels, resolution)

    def predict(
        self, images: Tensor, texels: TexelMap, seen: TexelViews, surface: Tensor, told: tuple[Tensor, ...] = ()
    ) -> Tensor:
        """(6, n, n) numbers of the baked colour and of the albedo, of no bounds.

        Args:
            images: (V, 4, H, W) linear, straight alpha: the views that `seen` was made from.
            texels: T texels a side.
            seen: of the V views.
            surface: (7, n, n), as of `surface`.
            told: (C, n, n) each.
        """
        fused, known = self._fuse_views(images, texels, seen, surface)
        return self.ffc(torch.cat([fused, known, surface[1:], *told])[None])[0].float()

    def _fuse_views(self, images: Tensor, texels: TexelMap, seen: TexelViews, surface: Tensor) -> tuple[Tensor, Tensor]:
        """(C, n, n) features, the maximum over the views that see a texel, 0 where none does; (1, n, n) any-seen."""
        resolution = surface.shape[-1]
        known = surface.new_zeros(1, resolution, resolution)
        fused: Tensor | None = None
        # One view after the other: all of them at once would multiply the memory by V.
        for view, image in enumerate(images):
            visible = cells(seen.visibility[view][None].float(), resolution)
            inputs = self._view_inputs(image, seen, view, visible, texels, surface)
            features = self.unet(inputs[None])[0]
            features = resized(features, resolution).masked_fill(visible == 0, torch.finfo(features.dtype).min)
            fused = features if fused is None else torch.maximum(fused, features)
            known = torch.maximum(known, visible)
        if fused is None:
            raise ValueError("no views")
        return fused.masked_fill(known == 0, 0.0), known

    def _view_inputs(
        self, image: Tensor, seen: TexelViews, view: int, visible: Tensor, texels: TexelMap, surface: Tensor
    ) -> Tensor:
        """(15 + C, n, n): image, mask, position, texture coordinates, view direction, normal, material."""
        material = self.encoder(composite(srgb_from_linear(image[:3]), image[3:], 1.0)[None])
        # Averaged in linear light, as a camera with larger pixels would.
        color = srgb_from_linear(mean(seen.color[view], visible))
        direction = mean(seen.direction(view, texels.position), visible)
        uv = _texture_coordinates(surface) * (surface[:1] > 0)
        # `where`, not a product: where a view does not see a texel its pixel may be anything, infinite too.
        pixels = seen.pixels[view].permute(2, 0, 1)
        pixels = mean(torch.where(seen.visibility[view], pixels, pixels.new_zeros(())), visible)  # (2, n, n)
        extent = pixels.new_tensor((image.shape[-1], image.shape[-2]))[:, None, None]
        grid = (2.0 * pixels / extent - 1.0).permute(1, 2, 0)
        sampled = functional.grid_sample(material, grid[None], padding_mode="border", align_corners=False)[0]
        return torch.cat([color, visible, surface[1:4], uv, direction, surface[4:], sampled * (visible > 0)])


def _texture_coordinates(like: Tensor) -> Tensor:
    """(2, n, n): u and v of the cells' centres; row 0 is v = 1."""
    side = like.shape[-1]
    centers = (torch.arange(side, device=like.device, dtype=like.dtype) + 0.5) / side
    return torch.stack(torch.meshgrid(centers, centers.flip(0), indexing="xy"))
