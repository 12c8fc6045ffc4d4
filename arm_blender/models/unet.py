"""The U-Net that reads what one view says of the atlas (Ronneberger et al. 2015), shared by all views.

Normalised by group: with batch 1 and a mostly empty atlas, batch statistics would be those of the gaps.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional


@dataclass(frozen=True)
class UnetConfig:
    """The per-view network at the paper's size (its widths are our choice: the paper is silent)."""

    widths: tuple[int, ...] = (64, 128, 256, 512)
    """Channels of each level, fine to coarse."""
    out_channels: int = 64
    """Features per texel and view that the views are pooled over; ours."""
    stem_stride: int = 1
    """2 runs every level at half the resolution: a quarter of the time for smooth outputs."""

    @property
    def multiple(self) -> int:
        """Input sizes are multiples of this."""
        return self.stem_stride * 2 ** (len(self.widths) - 1)


class ConvNorm(nn.Sequential):
    """3x3 convolution, group normalisation, SiLU."""

    def __init__(self, channels_in: int, channels_out: int, stride: int = 1) -> None:
        groups = next(groups for groups in (8, 4, 2, 1) if channels_out % groups == 0)
        super().__init__(
            nn.Conv2d(channels_in, channels_out, 3, stride, 1, bias=False),
            nn.GroupNorm(groups, channels_out),
            nn.SiLU(),
        )


class Unet(nn.Module):
    """Features of one view's texels."""

    def __init__(self, in_channels: int, config: UnetConfig) -> None:
        super().__init__()
        self.config = config
        widths = config.widths
        self.stem = ConvNorm(in_channels, widths[0], config.stem_stride)
        self.encoders = nn.ModuleList(ConvNorm(width, width) for width in widths)
        self.downs = nn.ModuleList(ConvNorm(a, b, stride=2) for a, b in zip(widths, widths[1:], strict=False))
        self.ups = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in zip(widths, widths[1:], strict=False))
        self.decoders = nn.ModuleList(ConvNorm(2 * width, width) for width in widths[:-1])
        self.out = nn.Conv2d(widths[0], config.out_channels, 1)

    @property
    def last(self) -> nn.Conv2d:
        """The output convolution; zero weights make the network start at zero."""
        return self.out

    def forward(self, x: Tensor) -> Tensor:
        """(B, in, H, W) -> (B, out, H / stem_stride, W / stem_stride); H and W multiples of `config.multiple`."""
        x = self.encoders[0](self.stem(x))
        skips = []
        for down, encoder in zip(self.downs, self.encoders[1:], strict=True):
            skips.append(x)
            x = encoder(down(x))
        for up, decoder, skip in zip(reversed(self.ups), reversed(self.decoders), reversed(skips), strict=True):
            x = functional.interpolate(up(x), scale_factor=2, mode="bilinear")
            x = decoder(torch.cat([x, skip], dim=1))
        return self.out(x)
