"""InstantAlbedo (ARM, section 5.2 and supplement): from what the views say of an atlas to its colours.

    per-view texels + material features --U-Net--> features --max over views--> fused --FFC-Net--> baked colour, albedo

The networks see sRGB; colours are linear at both ends. `paper` predicts both colours of every texel itself. `small`
predicts, on a coarse atlas, how much brighter each colour is than the blend of the views, so that sharp detail comes
from the views at full resolution and an untrained network already returns the blend.
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import torch
from torch import Tensor, nn
from torch.nn import functional

from ...graphics.color import composite, linear_from_srgb, srgb_from_linear
from ...structures import TexelMap, TexelViews
from ...uv.maps import diffuse_fill
from ..atlas_cells import cells, enlarged, mean, resized, scaled, surface_cells
from ..ffc import FfcConfig, FfcGenerator
from ..material_encoder import MaterialEncoder, MaterialEncoderConfig
from ..small.delighting import Delighting, DelightingConfig, SeenPoints
from ..unet import Unet, UnetConfig
from ..vit import VitConfig

_VIEW_CHANNELS = 15
"""Image 3, mask 1, position 3, texture coordinates 2, view direction 3, normal 3."""

_LOG_GAIN = 2.5
"""Bound on the logarithm of a correction: twelve times brighter or darker."""


Ablation = Literal[
    "none",
    "no-measurements",
    "no-material-prior",
    "random-material-prior",
    "local-unet",
    "unified-material",
    "no-super-resolution",
]
"""What is left out or replaced, to see what it is for (ARM, section 6 and supplement).

Without measurements the networks see all about a view but its colours. Without the material prior there is no encoder;
with a random one it begins at random weights. The local U-Net stands in for FFC-Net. Unified: roughness and metallic
are predicted here, too. Without super-resolution colours are predicted on the networks' coarse atlas and enlarged."""

_BLIND = ("no-measurements", "no-super-resolution")
"""Ablations that must not see or correct the blend of the views."""


@dataclass(frozen=True)
class InstantAlbedoConfig:
    """The paper's networks; where it is silent, docs of the parts say what was chosen."""

    encoder: MaterialEncoderConfig = MaterialEncoderConfig()
    """Reads the views for material, back-projected like their colours."""
    unet: UnetConfig = UnetConfig()
    """Reads each view's texels."""
    ffc: FfcConfig = FfcConfig()
    """Completes the fused atlas."""
    resolution: int | None = None
    """Texels a side that the networks run at; None is the atlas's own, as in the paper. Corrections are smoother."""
    residual: bool = False
    """Predict corrections of the blended views, not colours; the paper predicts colours."""
    ablation: Ablation = "none"
    """A part that is left out; weights fit no other choice."""
    delighting: DelightingConfig | None = None
    """Finds the light and divides it out of the blended views before the other networks; the paper has none."""

    def __post_init__(self) -> None:
        if self.ablation not in get_args(Ablation):
            raise ValueError(f"ablation {self.ablation!r}, expected one of {', '.join(get_args(Ablation))}")
        if self.residual and self.ablation in _BLIND:
            raise ValueError(f"{self.ablation}: corrections of the blend cannot do without it; residual must be off")
        if self.delighting is not None and not self.residual:
            raise ValueError("delighting corrects the blended views; residual must be on")

    def ablated(self, ablation: Ablation) -> "InstantAlbedoConfig":
        """This config without a part."""
        if ablation in _BLIND:
            return replace(self, ablation=ablation, residual=False, delighting=None)
        return replace(self, ablation=ablation)

    @property
    def multiple(self) -> int:
        """The networks' resolution is a multiple of this."""
        return max(self.unet.multiple, 2**self.ffc.downs)


PAPER = InstantAlbedoConfig()

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
    residual=True,
    delighting=DelightingConfig(),
)


class InstantAlbedo(nn.Module):
    """Two colours per texel, with and without the lighting of the views."""

    def __init__(self, config: InstantAlbedoConfig) -> None:
        super().__init__()
        self.config = config
        channels = _VIEW_CHANNELS - (3 if config.ablation == "no-measurements" else 0)
        self.encoder = None
        if config.ablation != "no-material-prior":
            self.encoder = MaterialEncoder(config.encoder)
            channels += config.encoder.out_channels
        self.unet = Unet(channels, config.unet)
        # Fused features, any-seen mask, position, normal; a correction must also see what it corrects, and where.
        fused = config.unet.out_channels + 7 + (4 if config.residual else 0)
        predicted = 8 if config.ablation == "unified-material" else 6
        if config.ablation == "local-unet":
            self.ffc = Unet(fused, replace(config.unet, out_channels=predicted, stem_stride=1))
        else:
            self.ffc = FfcGenerator(fused, predicted, config.ffc)
        if config.residual:
            nn.init.zeros_(self.ffc.last.weight)
            nn.init.zeros_(self.ffc.last.bias)
        self.delighting = None if config.delighting is None else Delighting(config.delighting)

    def forward(self, images: Tensor, texels: TexelMap, seen: TexelViews, base: Tensor) -> tuple[Tensor, Tensor]:
        """Colours of the atlas: the first two of `predict`."""
        albedo, baked, _ = self.predict(images, texels, seen, base)
        return albedo, baked

    def predict(
        self, images: Tensor, texels: TexelMap, seen: TexelViews, base: Tensor
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """What the networks say of the atlas.

        Args:
            images: (V, 4, H, W) linear, straight alpha: the views that `seen` was made from.
            texels: T texels a side.
            seen: of the V views.
            base: (3, T, T) linear: the blend of the views, filled where no view sees a covered texel.
        Returns:
            albedo, baked: (3, T, T) linear in [0, 1]; meaningless where no chart lies.
            gloss: (2, T, T) roughness and metallic in [0, 1]; None but in the ablation that predicts them.
        Raises:
            ValueError: shapes disagree, or the resolution does not suit the networks.
        """
        side = texels.mask.shape[-1]
        resolution = min(side, self.config.resolution or side)
        if resolution % self.config.multiple:
            raise ValueError(f"resolution {resolution} is no multiple of {self.config.multiple}")
        if base.shape != (3, side, side) or len(images) != len(seen.visibility):
            raise ValueError(f"{len(images)} images, {len(seen.visibility)} views, base {tuple(base.shape)}, T {side}")
        surface = surface_cells(texels, resolution)
        fused, known = self._fuse_views(images, texels, seen, surface)
        inputs = [fused, known, surface[1:]]
        if self.config.residual:
            known_base = torch.where(texels.mask, base, base.new_zeros(()))
            inputs += [surface[:1], srgb_from_linear(mean(known_base, surface[:1]))]
        predicted = self.ffc(torch.cat(inputs)[None])[0].float()  # (6, n, n)
        predicted, gloss = predicted[:6], predicted[6:].sigmoid() if len(predicted) > 6 else None
        if gloss is not None:
            gloss = enlarged(gloss, surface[:1], side)
        if self.config.residual:
            gain = enlarged(_LOG_GAIN * torch.tanh(predicted / _LOG_GAIN), surface[:1], side)
            # What a view sees is the baked colour; only what no view sees is the network's to say.
            unseen = 1.0 - enlarged(mean((seen.seen & texels.mask)[None].float(), surface[:1]), surface[:1], side)
            baked = scaled(base, unseen * gain[:3])
            if self.delighting is None:
                plain = scaled(base, gain[:3])
            else:
                plain = scaled(baked, self._without_light(texels, seen, surface))
            return scaled(plain, gain[3:]), baked, gloss
        colors = linear_from_srgb(torch.sigmoid(predicted))
        if resolution != side:
            colors = enlarged(colors, surface[:1], side)
        return colors[3:], colors[:3], gloss

    @torch.no_grad()
    def _without_light(self, texels: TexelMap, seen: TexelViews, surface: Tensor) -> Tensor:
        """(3, T, T) logarithm of albedo over the views' blend, found for cells that views see and spread to the others.

        Not learnt from here: `fit delighting` has its own samples.
        """
        side, resolution = texels.mask.shape[-1], surface.shape[-1]
        share = torch.cat([cells(visible[None].float(), resolution) for visible in seen.visibility])  # (V, n, n)
        covered, known = surface[0] > 0.0, share.amax(dim=0) > 0.0
        gain = surface.new_zeros(3, resolution, resolution)
        if not bool(known.any()):
            return gain.new_zeros(3, side, side)
        color = torch.stack([mean(c, s[None])[:, known].T for c, s in zip(seen.color, share, strict=True)])
        normal = functional.normalize(surface[4:, known].T, dim=1)
        points = (surface[1:4, known].T, normal, color, share[:, known] > 0.0, seen.eyes)
        gain[:, known] = self.delighting.log_gain(SeenPoints(*(part[None] for part in points))).T
        gain = diffuse_fill(gain, known, TexelMap(surface[1:4], surface[4:], covered))
        return enlarged(gain, surface[:1], side)

    def _fuse_views(self, images: Tensor, texels: TexelMap, seen: TexelViews, surface: Tensor) -> tuple[Tensor, Tensor]:
        """(C, n, n) features, the maximum over the views that see a texel, 0 where none does; (1, n, n) any-seen."""
        resolution = surface.shape[-1]
        size = (images.shape[-1], images.shape[-2])
        fused, known = None, surface.new_zeros(1, resolution, resolution)
        # One view after the other: all of them at once would multiply the memory by V.
        for view, image in enumerate(images):
            material = None
            if self.encoder is not None:
                material = self.encoder(composite(srgb_from_linear(image[:3]), image[3:], 1.0)[None])[0]
            visible = cells(seen.visibility[view][None].float(), resolution)
            inputs = self._view_inputs(seen, view, visible, texels, surface, material, size)
            features = self.unet(inputs[None])[0]
            features = resized(features, resolution).masked_fill(visible == 0, torch.finfo(features.dtype).min)
            fused = features if fused is None else torch.maximum(fused, features)
            known = torch.maximum(known, visible)
        return fused.masked_fill(known == 0, 0.0), known

    def _view_inputs(
        self,
        seen: TexelViews,
        view: int,
        visible: Tensor,
        texels: TexelMap,
        surface: Tensor,
        material: Tensor | None,
        size: tuple[int, int],
    ) -> Tensor:
        """(15 + C, n, n): image, mask, position, texture coordinates, view direction, normal, material.

        Image or material are absent where the ablation leaves them out.
        """
        mask = seen.visibility[view]
        direction = mean(seen.direction(view, texels.position), visible)
        uv = _texture_coordinates(surface) * (surface[:1] > 0)
        parts = [visible, surface[1:4], uv, direction, surface[4:]]
        if self.config.ablation != "no-measurements":
            # Averaged in linear light, as a camera with larger pixels would.
            parts.insert(0, srgb_from_linear(mean(seen.color[view], visible)))
        if material is not None:
            # `where`, not a product: where a view does not see a texel its pixel may be anything, infinite too.
            pixels = seen.pixels[view].permute(2, 0, 1)
            pixels = mean(torch.where(mask, pixels, pixels.new_zeros(())), visible)  # (2, n, n)
            extent = pixels.new_tensor(size)[:, None, None]
            grid = (2.0 * pixels / extent - 1.0).permute(1, 2, 0)
            sampled = functional.grid_sample(material[None], grid[None], padding_mode="border", align_corners=False)[0]
            parts.append(sampled * (visible > 0))
        return torch.cat(parts)


def _texture_coordinates(like: Tensor) -> Tensor:
    """(2, n, n): u and v of the cells' centres; row 0 is v = 1."""
    side = like.shape[-1]
    centers = (torch.arange(side, device=like.device, dtype=like.dtype) + 0.5) / side
    return torch.stack(torch.meshgrid(centers, centers.flip(0), indexing="xy"))
