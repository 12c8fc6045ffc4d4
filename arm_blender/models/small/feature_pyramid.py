"""What a view is looked up in: its pictures' features, and the depth of the surface that it seems to show."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class ResidualConv(nn.Module):
    """x + conv(relu(conv(relu(x)))), as (B, C, H, W)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class FeaturePyramid(nn.Module):
    """A view to features and depth at half resolution; the image encoder's tokens and the hull join at a quarter."""

    INPUTS = 6

    def __init__(self, channels: int, token_width: int) -> None:
        super().__init__()
        self.to_half = nn.Sequential(nn.Conv2d(self.INPUTS, channels, 3, stride=2, padding=1), ResidualConv(channels))
        self.to_quarter = nn.Sequential(
            nn.Conv2d(channels + 2, 2 * channels, 3, stride=2, padding=1),
            ResidualConv(2 * channels),
            ResidualConv(2 * channels),
        )
        self.from_tokens = nn.Conv2d(token_width, 2 * channels, 1)
        self.merge = nn.Sequential(
            ResidualConv(2 * channels), nn.ReLU(), nn.Conv2d(2 * channels, channels, 3, padding=1)
        )
        self.to_depth = nn.Sequential(ResidualConv(channels), nn.ReLU(), nn.Conv2d(channels, 1, 1))

    def forward(self, images: Tensor, tokens: Tensor, hull: Tensor) -> tuple[Tensor, Tensor]:
        """Features (B, C, H/2, W/2) and depth (B, 1, H/2, W/2).

        Args:
            images: (B, 6, H, W) colour, coverage, silhouette distance and size of a pixel in world units.
            tokens: (B, D, h, w).
            hull: (B, 2, H/2, W/2) whether the visual hull is met, and its depth: what the depth starts from.
        """
        half = self.to_half(images)
        quarter = self.to_quarter(torch.cat([F.relu(half), hull], dim=1))
        tokens = F.interpolate(self.from_tokens(tokens), size=quarter.shape[-2:], mode="bilinear", align_corners=False)
        merged = self.merge(quarter + tokens)
        features = half + F.interpolate(merged, size=half.shape[-2:], mode="bilinear", align_corners=False)
        return features, hull[:, 1:] + self.to_depth(features)
