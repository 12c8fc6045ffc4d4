"""Triplanes: the super-resolution upsampler, sampling at points, and the decoder (ARM, supplement, figure 9).

The upsampler has the residual-in-residual dense blocks of ESRGAN (https://arxiv.org/abs/1809.00219). The paper gives
four blocks of 512 filters and three convolutions from 32 to 256. Slopes and residual scales of 0.2 are ESRGAN's; the
convolution before the blocks and the halved widths after them are ours.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F


@dataclass(frozen=True)
class UpsamplerConfig:
    """The paper's upsampler of planes (figure 9)."""

    filters: int = 512
    """Channels of the residual blocks (paper: 512)."""
    blocks: int = 4
    """Residual-in-residual dense blocks (paper: 4)."""
    growth: int = 32
    """Channels that each dense convolution adds; unstated in the paper, 32 is ESRGAN's."""
    doublings: int = 3
    """Nearest-neighbour doublings, one convolution each (paper: three convolutions, 32 to 256)."""
    channels: int = 80
    """Of the fine planes; unstated in the paper, 80 is InstantMesh's."""
    deconvolution: bool = False
    """Add what InstantMesh's deconvolution makes, enlarged: with its weights, training starts where it ended. The last
    convolution then begins at zero, and costs nothing at inference until it has learnt something."""


@dataclass(frozen=True)
class DecoderConfig:
    """The MLP from a point's feature to raw numbers."""

    hidden_layers: int = 4
    """Paper: 4; the ReLU between them is InstantMesh's."""
    hidden: int = 32
    """Channels of a hidden layer (paper: 32)."""


class DenseBlock(nn.Module):
    """Five convolutions, each reading all features before it, within a residual."""

    def __init__(self, filters: int, growth: int) -> None:
        super().__init__()
        self.convs = nn.ModuleList(
            nn.Conv2d(filters + i * growth, growth if i < 4 else filters, 3, padding=1) for i in range(5)
        )

    def forward(self, x: Tensor) -> Tensor:
        features = [x]
        for conv in self.convs[:-1]:
            features.append(F.leaky_relu(conv(torch.cat(features, dim=1)), 0.2))
        return x + 0.2 * self.convs[-1](torch.cat(features, dim=1))


class ResidualDenseBlock(nn.Module):
    """Three dense blocks within a residual (RRDB)."""

    def __init__(self, filters: int, growth: int) -> None:
        super().__init__()
        self.blocks = nn.Sequential(*(DenseBlock(filters, growth) for _ in range(3)))

    def forward(self, x: Tensor) -> Tensor:
        return x + 0.2 * self.blocks(x)


class Upsampler(nn.Module):
    """Coarse planes to fine ones: (B * 3, D, R, R) to (B * 3, C, R * 2**doublings, ...)."""

    def __init__(self, config: UpsamplerConfig, width: int) -> None:
        super().__init__()
        self.head = nn.Conv2d(width, config.filters, 3, padding=1)
        self.trunk = nn.Sequential(
            *(ResidualDenseBlock(config.filters, config.growth) for _ in range(config.blocks)),
            nn.Conv2d(config.filters, config.filters, 3, padding=1),
        )
        widths = [config.filters // 2**i for i in range(config.doublings)] + [config.channels]
        self.up = nn.ModuleList(nn.Conv2d(a, b, 3, padding=1) for a, b in zip(widths[:-1], widths[1:], strict=True))
        self.deconv = None
        if config.deconvolution:
            self.deconv = nn.ConvTranspose2d(width, config.channels, 2, stride=2)
            for parameter in self.up[-1].parameters():
                nn.init.zeros_(parameter)

    def forward(self, x: Tensor) -> Tensor:
        if self.deconv is None:
            return self.detail(x)
        planes = self.deconv(x)
        if len(self.up) > 1:
            planes = F.interpolate(planes, scale_factor=2 ** (len(self.up) - 1), mode="bilinear", align_corners=False)
        learnt = torch.is_grad_enabled() or any(parameter.any() for parameter in self.up[-1].parameters())
        return planes + self.detail(x) if learnt else planes

    def features(self, x: Tensor) -> Tensor:
        """(B * 3, filters, R, R): the residual blocks' own."""
        x = self.head(x)
        return x + self.trunk(x)

    def detail(self, x: Tensor) -> Tensor:
        """The super-resolution: (B * 3, C, R * 2**doublings, ...)."""
        x = self.features(x)
        for index, conv in enumerate(self.up):
            x = conv(F.interpolate(x, scale_factor=2, mode="nearest"))
            if index < len(self.up) - 1:
                x = F.leaky_relu(x, 0.2)
        return x


def sample_planes(planes: Tensor, points: Tensor) -> Tensor:
    """Features of points on the planes (x, y), (x, z), (z, y); the first coordinate runs along the width.

    Args:
        planes: (B, 3, C, R, R) spanning [-1, 1].
        points: (B, P, 3) world; zero outside of the planes.
    Returns:
        (B, P, 3 * C).
    """
    batch, count = points.shape[:2]
    uv = torch.stack([points[..., [0, 1]], points[..., [0, 2]], points[..., [2, 1]]], dim=1)  # (B, 3, P, 2)
    features = F.grid_sample(planes.flatten(0, 1), uv.flatten(0, 1).unsqueeze(2), align_corners=False)
    return features.reshape(batch, -1, count).transpose(1, 2)


def decoder(config: DecoderConfig, inputs: int, outputs: int) -> nn.Sequential:
    """The MLP that reads a point's feature: `hidden_layers` of `hidden` channels, ReLU."""
    layers, width = [], inputs
    for _ in range(config.hidden_layers):
        layers += [nn.Linear(width, config.hidden), nn.ReLU()]
        width = config.hidden
    return nn.Sequential(*layers, nn.Linear(width, outputs))
