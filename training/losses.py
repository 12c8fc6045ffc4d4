"""The image loss of the appearance stages (ARM, section 5.4): squared error, perceptual distance, structure."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

Perceptual = Callable[[Tensor, Tensor], Tensor]
"""Distance of two batches (V, 3, H, W) in [0, 1] as one number; LPIPS where its weights are at hand."""

_RADIUS, _SIGMA = 5, 1.5  # Wang et al. 2004.
_C1, _C2 = 0.01**2, 0.03**2  # For a range of 1.


@dataclass(frozen=True)
class ImageLossConfig:
    """The paper's balance."""

    squared: float = 0.7
    """Weight of the mean squared error."""
    perceptual: float = 0.3
    """Weight of the perceptual distance; its term is absent without one."""
    structure: float = 0.1
    """Weight of 1 - SSIM."""


def image_loss(
    x: Tensor,
    y: Tensor,
    mask: Tensor,
    config: ImageLossConfig = ImageLossConfig(),
    perceptual: Perceptual | None = None,
) -> Tensor:
    """The paper's L_0 over the pixels that show the object.

    Args:
        x: (V, C, H, W) sRGB or a scalar map, in [0, 1].
        y: the truth, the same shape.
        mask: (V, H, W) bool. Outside it both images count as white; squared error and structure are means inside it, so
            that a small object weighs as much as a large one.
        perceptual: of three channels; one channel is repeated.
    Returns:
        A scalar; 0 where the mask is empty.
    Raises:
        ValueError: shapes differ.
    """
    if x.shape != y.shape or mask.shape != (x.shape[0], *x.shape[2:]):
        raise ValueError(f"x {tuple(x.shape)}, y {tuple(y.shape)}, mask {tuple(mask.shape)}")
    inside = mask[:, None]
    x, y = torch.where(inside, x, 1.0), torch.where(inside, y, 1.0)
    loss = config.squared * _mean_inside((x - y).square(), inside)
    if config.structure:
        window = inside[..., _RADIUS:-_RADIUS, _RADIUS:-_RADIUS]
        loss = loss + config.structure * _mean_inside(1.0 - similarity(x, y), window)
    if perceptual is not None:
        loss = loss + config.perceptual * perceptual(x.expand(-1, 3, -1, -1), y.expand(-1, 3, -1, -1))
    return loss


def similarity(x: Tensor, y: Tensor) -> Tensor:
    """Structural similarity (Wang et al. 2004) with a Gaussian window of 11 pixels, sigma 1.5.

    Args:
        x: (V, C, H, W) in [0, 1], at least 11 pixels a side.
        y: the same shape.
    Returns:
        (V, C, H - 10, W - 10) in [-1, 1]: the windows that lie inside.
    """
    taps = torch.arange(-_RADIUS, _RADIUS + 1, dtype=x.dtype, device=x.device)
    taps = torch.exp(-0.5 * (taps / _SIGMA) ** 2)
    taps = taps / taps.sum()

    def blurred(images: Tensor) -> Tensor:
        planes = images.flatten(0, 1)[:, None]  # (V * C, 1, H, W)
        planes = functional.conv2d(functional.conv2d(planes, taps.view(1, 1, 1, -1)), taps.view(1, 1, -1, 1))
        return planes[:, 0].unflatten(0, images.shape[:2])

    mean_x, mean_y = blurred(x), blurred(y)
    variance_x = blurred(x * x) - mean_x * mean_x
    variance_y = blurred(y * y) - mean_y * mean_y
    covariance = blurred(x * y) - mean_x * mean_y
    luminance = (2.0 * mean_x * mean_y + _C1) / (mean_x * mean_x + mean_y * mean_y + _C1)
    return luminance * (2.0 * covariance + _C2) / (variance_x + variance_y + _C2)


def _mean_inside(values: Tensor, inside: Tensor) -> Tensor:
    """Mean of (V, C, H, W) where (V, 1, H, W) holds."""
    return (values * inside).sum() / (inside.sum() * values.shape[1]).clamp(min=1)
