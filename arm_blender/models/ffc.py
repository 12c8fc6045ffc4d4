"""Fast Fourier convolutions and the in-painting generator built from them.

Chi et al. 2020 (FFC); Suvorov et al. 2022 (LaMa, arXiv 2109.07161), whose layout and keys this follows, so that its
generators load unmapped. A spectral branch sees the whole atlas at once, which is what in-painting needs.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

Norm = Literal["batch", "group"]


@dataclass(frozen=True)
class FfcConfig:
    """The generator at the paper's size: 3 down, 4 residual blocks at 512 channels, 3 up."""

    width: int = 64
    """Channels after the stem; each halving of the resolution doubles them (paper: 512 in the residual blocks)."""
    downs: int = 3
    """Halvings (paper: 3). Input sizes are multiples of 2**downs."""
    blocks: int = 4
    """Residual Fourier blocks at the bottom (paper: 4)."""
    ratio: float = 0.75
    """Share of channels in the global (spectral) branch; unstated in the paper, 0.75 is LaMa's."""
    norm: Norm = "group"
    """Batch statistics are poor at batch 1 over a mostly empty atlas; "batch" is for published weights."""


class FourierUnit(nn.Module):
    """A 1x1 convolution of the spectrum: each output value depends on the whole input."""

    def __init__(self, channels: int, norm: Norm) -> None:
        super().__init__()
        self.conv_layer = nn.Conv2d(2 * channels, 2 * channels, 1, bias=False)
        self.bn = _norm(2 * channels, norm)

    def forward(self, x: Tensor) -> Tensor:
        # Half-precision transforms lack sizes (cuFFT) or do not exist (CPU), and overflow: float32 at least.
        precise = torch.promote_types(x.dtype, torch.float32)
        spectrum = torch.fft.rfft2(x.to(precise), norm="ortho")
        parts = torch.stack([spectrum.real, spectrum.imag], dim=2).flatten(1, 2)  # channel 2c real, 2c + 1 imaginary
        parts = functional.relu(self.bn(self.conv_layer(parts.to(x.dtype)))).to(precise).unflatten(1, (-1, 2))
        spectrum = torch.complex(parts[:, :, 0], parts[:, :, 1])
        return torch.fft.irfft2(spectrum, s=x.shape[-2:], norm="ortho").to(x.dtype)


class SpectralTransform(nn.Module):
    """The global branch's own path: a Fourier unit at half width, residual."""

    def __init__(self, channels: int, norm: Norm) -> None:
        super().__init__()
        half = channels // 2
        self.conv1 = nn.Sequential(nn.Conv2d(channels, half, 1, bias=False), _norm(half, norm), nn.ReLU())
        self.fu = FourierUnit(half, norm)
        self.conv2 = nn.Conv2d(half, channels, 1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        x = self.conv1(x)
        return self.conv2(x + self.fu(x))


class FastFourierConv(nn.Module):
    """A convolution between a local and a global branch; a global branch of width 0 is `None`."""

    def __init__(self, into: tuple[int, int], out: tuple[int, int], kernel: int, stride: int, norm: Norm) -> None:
        super().__init__()

        def conv(channels_in: int, channels_out: int) -> nn.Conv2d:
            # The stem pads its own input, the rest pad here.
            padding = 1 if kernel == 3 else 0
            return nn.Conv2d(channels_in, channels_out, kernel, stride, padding, padding_mode="reflect", bias=False)

        self.convl2l = conv(into[0], out[0])
        self.convl2g = conv(into[0], out[1]) if out[1] else None
        self.convg2l = conv(into[1], out[0]) if into[1] else None
        self.convg2g = SpectralTransform(out[1], norm) if into[1] and out[1] else None

    def forward(self, local: Tensor, spread: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """(local, global) -> (local, global)."""
        new_local = self.convl2l(local)
        if spread is not None and self.convg2l is not None:
            new_local = new_local + self.convg2l(spread)
        if self.convl2g is None:
            return new_local, None
        new_spread = self.convl2g(local)
        if spread is not None and self.convg2g is not None:
            new_spread = new_spread + self.convg2g(spread)
        return new_local, new_spread


class FfcLayer(nn.Module):
    """Convolution, normalisation, ReLU. `bn_*` keep LaMa's keys whichever the normalisation."""

    def __init__(
        self, into: tuple[int, int], out: tuple[int, int], kernel: int = 3, stride: int = 1, norm: Norm = "group"
    ) -> None:
        super().__init__()
        self.ffc = FastFourierConv(into, out, kernel, stride, norm)
        self.bn_l = _norm(out[0], norm)
        self.bn_g = _norm(out[1], norm) if out[1] else None

    def forward(self, branches: tuple[Tensor, Tensor | None]) -> tuple[Tensor, Tensor | None]:
        local, spread = self.ffc(*branches)
        local = functional.relu(self.bn_l(local))
        if spread is not None and self.bn_g is not None:
            spread = functional.relu(self.bn_g(spread))
        return local, spread


class FfcBlock(nn.Module):
    """Two layers, residual in both branches."""

    def __init__(self, width: tuple[int, int], norm: Norm) -> None:
        super().__init__()
        self.conv1 = FfcLayer(width, width, norm=norm)
        self.conv2 = FfcLayer(width, width, norm=norm)

    def forward(self, branches: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        local, spread = self.conv2(self.conv1(branches))
        return branches[0] + local, branches[1] + spread


class Join(nn.Module):
    """Both branches side by side as one tensor."""

    def forward(self, branches: tuple[Tensor, Tensor]) -> Tensor:
        return torch.cat(branches, dim=1)


class Split(nn.Module):
    """The image as a local branch, padded for the stem; there is no global branch yet."""

    def forward(self, x: Tensor) -> tuple[Tensor, None]:
        return functional.pad(x, (3, 3, 3, 3), mode="reflect"), None


class FfcGenerator(nn.Module):
    """Stem, downsampling, Fourier blocks, upsampling; one sequence, because of LaMa's keys (`model.N`)."""

    def __init__(self, in_channels: int, out_channels: int, config: FfcConfig) -> None:
        super().__init__()
        self.config = config
        norm, width = config.norm, config.width
        layers: list[nn.Module] = [Split(), FfcLayer((in_channels, 0), (width, 0), kernel=7, norm=norm)]
        for index in range(config.downs):
            last = index == config.downs - 1
            spread = int(2 * width * config.ratio) if last else 0
            layers.append(FfcLayer((width, 0), (2 * width - spread, spread), stride=2, norm=norm))
            width *= 2
        spread = int(width * config.ratio)
        layers += [FfcBlock((width - spread, spread), norm) for _ in range(config.blocks)]
        layers.append(Join())
        for _ in range(config.downs):
            up = nn.ConvTranspose2d(width, width // 2, 3, stride=2, padding=1, output_padding=1)
            layers += [up, _norm(width // 2, norm), nn.ReLU()]
            width //= 2
        layers += [nn.ReflectionPad2d(3), nn.Conv2d(width, out_channels, 7)]
        self.model = nn.Sequential(*layers)

    @property
    def last(self) -> nn.Conv2d:
        """The output convolution; zero weights make the generator start at zero."""
        last = self.model[-1]
        assert isinstance(last, nn.Conv2d)
        return last

    def forward(self, x: Tensor) -> Tensor:
        """(B, in, H, W) -> (B, out, H, W), without an output activation; H and W multiples of 2**downs."""
        return self.model(x)


def _norm(channels: int, norm: Norm) -> nn.Module:
    if norm == "batch":
        return nn.BatchNorm2d(channels)
    return nn.GroupNorm(next(groups for groups in (8, 4, 2, 1) if channels % groups == 0), channels)
