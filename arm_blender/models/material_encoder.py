"""The material-aware image encoder of InstantAlbedo (ARM, section 5.3): ViT tokens of four depths, fused to pixels.

The cascade follows the architecture that the paper names (Sharma et al. 2023, "Materialistic") without its
cross-attention; written from its formulas.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from .vit import VisionTransformer, VitConfig

_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # ImageNet, as DINO was trained.

_FACTORS = (4, 2, 1, 1)
"""How much finer than the token grid each context is; each fusion but the deepest doubles the resolution again."""


@dataclass(frozen=True)
class MaterialEncoderConfig:
    """The paper's encoder, a ViT-B/8 under a cascade; the numbers that it leaves out are Materialistic's."""

    vit: VitConfig = VitConfig()
    """The transformer under the cascade."""
    taps: tuple[int, int, int, int] = (2, 5, 8, 11)
    """Blocks whose tokens are fused, shallow to deep."""
    image_size: int = 512
    """Pixels a side that images are resized to; a multiple of the patch. Memory grows with its fourth power."""
    channels: int = 256
    """Width of the cascade."""
    out_channels: int = 32
    """Features per pixel; ours. Materialistic's 256 would take 6.4 GB for six atlases of 1024 texels a side."""


class Context(nn.Module):
    """Tokens of one depth as a map: the CLS token mixed into each patch token, 1x1 convolution, resampling."""

    def __init__(self, dim: int, channels: int, factor: int) -> None:
        super().__init__()
        self.factor = factor
        self.readout = nn.Linear(2 * dim, dim)
        self.conv = nn.Conv2d(dim, channels, 1)

    def forward(self, tokens: Tensor, rows: int, columns: int) -> Tensor:
        patches = tokens[:, 1:]  # (B, L, D)
        mixed = self.readout(torch.cat([patches, tokens[:, :1].expand_as(patches)], dim=-1))
        return _enlarge(self.conv(mixed.transpose(1, 2).unflatten(2, (rows, columns))), self.factor)


class ResidualUnit(nn.Module):
    """x + conv(relu(conv(relu(x)))); the second convolution has no bias."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(functional.relu(self.conv1(functional.relu(x))))


class Fusion(nn.Module):
    """Join a context with the path from below and double the resolution."""

    def __init__(self, channels: int, factor: int, joins: bool) -> None:
        super().__init__()
        self.factor = factor
        # The deepest fusion has no path below it.
        self.join = ResidualUnit(channels) if joins else None
        self.refine = ResidualUnit(channels)
        self.out = nn.Conv2d(channels, channels, 1)

    def forward(self, context: Tensor, path: Tensor | None = None) -> Tensor:
        if self.join is not None and path is not None:
            context = context + self.join(path)
        return self.out(_enlarge(self.refine(context), self.factor))


class MaterialEncoder(nn.Module):
    """Per-pixel material features of images."""

    mean: Tensor
    std: Tensor

    def __init__(self, config: MaterialEncoderConfig) -> None:
        super().__init__()
        self.config = config
        self.vit = VisionTransformer(config.vit)
        self.contexts = nn.ModuleList(Context(config.vit.dim, config.channels, factor) for factor in _FACTORS)
        self.fusions = nn.ModuleList(Fusion(config.channels, 1 if k == 3 else 2, joins=k < 3) for k in range(4))
        self.head = nn.Conv2d(config.channels, config.out_channels, 1)
        # Constants, not weights: there even in a module that is built without memory.
        self.register_buffer("mean", torch.tensor(_MEAN, device="cpu").view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(_STD, device="cpu").view(3, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """Features of images.

        Args:
            images: (B, 3, H, W) sRGB in [0, 1], over a background; any size.
        Returns:
            (B, C, S, S), S = 8 * image_size / patch, covering the whole image.
        """
        size = self.config.image_size
        if images.shape[-2:] != (size, size):
            images = functional.interpolate(images, (size, size), mode="bilinear", antialias=True)
        tokens = self.vit((images - self.mean) / self.std, self.config.taps)
        grid = size // self.config.vit.patch
        return self.head(self.fuse(tokens, grid, grid))

    def fuse(self, tokens: list[Tensor], rows: int, columns: int) -> Tensor:
        """The cascade: four sequences (B, 1 + rows * columns, D), shallow to deep -> (B, C, 8 rows, 8 columns)."""
        contexts = [context(t, rows, columns) for context, t in zip(self.contexts, tokens, strict=True)]
        path = self.fusions[3](contexts[3])
        for k in (2, 1, 0):
            path = self.fusions[k](contexts[k], path)
        return path


def _enlarge(x: Tensor, factor: int) -> Tensor:
    """Bilinear, corners aligned."""
    if factor == 1:
        return x
    return functional.interpolate(x, scale_factor=factor, mode="bilinear", align_corners=True)
