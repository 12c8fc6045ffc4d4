"""What of any photograph is the object: a small U-Net that looks at the whole picture once, where it is coarsest.

Convolutions tell edges and textures apart; which of them belong to the thing that was photographed is decided between
all places of the picture, by attention at a sixteenth of its resolution (as in TransUNet, Chen et al. 2021,
arXiv 2102.04306).
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..unet import ConvNorm


@dataclass(frozen=True)
class CutoutConfig:
    """Sizes for a second on one processor core."""

    widths: tuple[int, ...] = (16, 32, 64, 128)
    """Channels at a half, a quarter, an eighth and a sixteenth of the resolution."""
    depths: tuple[int, ...] = (0, 1, 2, 2)
    """Residual blocks of each level."""
    attention_layers: int = 2
    """At the coarsest level. None of them: a shadow far from its object is taken for a part of it."""
    heads: int = 4
    """Of the attention; they divide the last width."""
    side: int = 128
    """Pixels of the longer side of a picture at first; the network was fitted on squares of 128."""
    closer_side: int = 160
    """As `side`, of a closer look at the object."""
    evidence: int = 0
    """Channels beside the colours, where something else is known about each pixel."""

    @property
    def multiple(self) -> int:
        """Input sizes are multiples of this."""
        return 2 ** len(self.widths)


class Residual(nn.Module):
    """x + conv(conv(x)), as (B, C, H, W)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.convs = nn.Sequential(ConvNorm(channels, channels), ConvNorm(channels, channels))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.convs(x)


class GlobalAttention(nn.Module):
    """Every place of a map (B, C, H, W) attends to every other; where it is, its neighbours tell it."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.place = nn.Conv2d(channels, channels, 5, padding=2, groups=channels)
        self.norm1, self.norm2 = nn.LayerNorm(channels), nn.LayerNorm(channels)
        self.qkv = nn.Linear(channels, 3 * channels)
        self.out = nn.Linear(channels, channels)
        self.mlp = nn.Sequential(nn.Linear(channels, 4 * channels), nn.GELU(), nn.Linear(4 * channels, channels))

    def forward(self, x: Tensor) -> Tensor:
        height, width = x.shape[-2:]
        tokens = (x + self.place(x)).flatten(2).transpose(1, 2)  # (B, L, C)
        q, k, v = self.qkv(self.norm1(tokens)).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
        tokens = tokens + self.out(mixed)
        tokens = tokens + self.mlp(self.norm2(tokens))
        return tokens.transpose(1, 2).unflatten(2, (height, width))


class Cutout(nn.Module):
    """The object's alpha in a photograph, as logits."""

    def __init__(self, config: CutoutConfig) -> None:
        super().__init__()
        self.config = config
        widths = config.widths
        self.downs = nn.ModuleList(
            ConvNorm(before, width, stride=2)
            for before, width in zip((6 + config.evidence, *widths), widths, strict=False)
        )
        self.encoders = nn.ModuleList(
            nn.Sequential(*(Residual(width) for _ in range(depth)))
            for width, depth in zip(widths, config.depths, strict=True)
        )
        self.attention = nn.Sequential(
            *(GlobalAttention(widths[-1], config.heads) for _ in range(config.attention_layers))
        )
        self.ups = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in zip(widths, widths[1:], strict=False))
        self.decoders = nn.ModuleList(ConvNorm(2 * width, width) for width in widths[:-1])
        self.out = nn.Conv2d(widths[0], 4, 3, padding=1)
        self.coarse = nn.Conv2d(widths[-1], 1, 1)

    def forward(self, picture: Tensor) -> Tensor:
        """Logits of alpha (B, 1, H, W), as `both` gives them."""
        return self.both(picture)[0]

    def both(self, picture: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of alpha, and what is known of it before its outline is: the coarsest level learns by them.

        Args:
            picture: (B, 3 + E, H, W), sRGB in [0, 1] and E = `config.evidence` channels in [-1, 1]; H and W multiples
                of `config.multiple`.
        Returns:
            (B, 1, H, W), and (B, 1, H / multiple, W / multiple).
        Raises:
            ValueError: wrong shape.
        """
        multiple, channels = self.config.multiple, 3 + self.config.evidence
        shape = tuple(picture.shape)
        if len(shape) != 4 or shape[1] != channels or shape[2] % multiple or shape[3] % multiple:
            raise ValueError(f"pictures must be (B, {channels}, H, W), multiples of {multiple}, got {shape}")
        srgb, told = picture[:, :3], picture[:, 3:]
        x, skips = torch.cat([2.0 * srgb - 1.0, _place(srgb), _unlike_border(srgb), told], dim=1), []
        for down, encoder in zip(self.downs, self.encoders, strict=True):
            x = encoder(down(x))
            skips.append(x)
        x = self.attention(skips.pop())
        coarse = self.coarse(x)
        for up, decoder, skip in zip(reversed(self.ups), reversed(self.decoders), reversed(skips), strict=True):
            x = functional.interpolate(up(x), scale_factor=2, mode="bilinear")
            x = decoder(torch.cat([x, skip], dim=1))
        return functional.pixel_shuffle(self.out(x), 2), coarse


_PATCHES = 12
"""Along each side of a picture: pieces of its border whose mean colours stand for the background."""


def _unlike_border(srgb: Tensor) -> Tensor:
    """(B, 1, H, W): how far a colour (B, 3, H, W) is from those along the border, which mostly are background."""
    strip = [max(1, side // 16) for side in srgb.shape[-2:]]
    rows = torch.cat([srgb[:, :, : strip[0]], srgb[:, :, -strip[0] :]], dim=1)  # (B, 6, h, W)
    columns = torch.cat([srgb[..., : strip[1]], srgb[..., -strip[1] :]], dim=1)
    means = [
        functional.adaptive_avg_pool2d(edge, size).unflatten(1, (2, 3)).permute(0, 1, 3, 4, 2).flatten(1, 3)
        for edge, size in ((rows, (1, _PATCHES)), (columns, (_PATCHES, 1)))
    ]
    colors = srgb.flatten(2).transpose(1, 2)  # (B, H * W, 3)
    near = torch.cdist(colors, torch.cat(means, dim=1)).amin(dim=2)
    return near.unflatten(1, srgb.shape[-2:])[:, None]


def _place(image: Tensor) -> Tensor:
    """(B, 2, H, W): how far right and down a pixel is, -1 to 1: things are photographed in the middle."""
    batch, _, height, width = image.shape
    y, x = torch.linspace(-1.0, 1.0, height).to(image), torch.linspace(-1.0, 1.0, width).to(image)
    return torch.stack(torch.meshgrid(y, x, indexing="ij")).flip(0).expand(batch, -1, -1, -1)
