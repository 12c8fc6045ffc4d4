"""The paper's losses (ARM, section 5.4).

Of pictures: squared error, perceptual distance, structure. Of shapes: depth, mask and normals (equation 2).
"""

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


@dataclass(frozen=True)
class SurfaceMaps:
    """What V views show of a surface.

    Attributes:
        mask: (V, H, W) opacity in [0, 1].
        depth: (V, H, W) along the view axis, world units. Of the truth: infinity is background. Of a rendering: times
            the opacity.
        normal: (V, 3, H, W) world, outward, of unit length or shorter.
    """

    mask: Tensor
    depth: Tensor
    normal: Tensor


DEPTH_WEIGHT, MASK_WEIGHT, NORMAL_WEIGHT = 0.5, 1.0, 0.2
"""The paper's weights of depth's absolute error (lambda_z), the mask's squared error (lambda_M) and the distance of
normals (lambda_n)."""


def geometry_loss(found: SurfaceMaps, truth: SurfaceMaps, perceptual: Perceptual | None = None) -> dict[str, Tensor]:
    """The paper's L_geo, term by term; it is their sum.

    Depth and normals are compared where both have an object: pixels count by the opacity found. Otherwise a pixel that
    is half transparent would have half of the depth, and to fatten the object's outline would pay.

    Args:
        perceptual: compares pictures of normals, black where nothing is, as the paper does. Without it the term is one
            minus the cosine.
    Returns:
        scalars: depth, mask, normal; finite for whatever depth the background has.
    Raises:
        ValueError: shapes differ.
    """
    for name in ("mask", "depth", "normal"):
        if getattr(found, name).shape != getattr(truth, name).shape:
            raise ValueError(f"{name}: {tuple(getattr(found, name).shape)}, {tuple(getattr(truth, name).shape)}")
    seen = (truth.mask > 0.5) & truth.depth.isfinite()
    count = seen.sum().clamp(min=1)
    # Masked before the difference: infinity times zero is no number.
    away = (found.depth - found.mask * torch.where(seen, truth.depth, 0.0)).abs()
    if perceptual is None:
        both = seen * found.mask.detach()
        normal = ((1.0 - (found.normal * truth.normal).sum(dim=1)) * both).sum() / count
    else:
        normal = perceptual(*(0.5 * (maps.normal + 1.0) * maps.mask[:, None] for maps in (found, truth)))
    return {
        "depth": DEPTH_WEIGHT * (away * seen).sum() / count,
        "mask": MASK_WEIGHT * (found.mask - truth.mask).square().mean(),
        "normal": NORMAL_WEIGHT * normal,
    }


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
