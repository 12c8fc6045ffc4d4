"""Transfer functions between linear Rec.709 and sRGB (IEC 61966-2-1), 8-bit values, compositing of straight alpha."""

from torch import Tensor, uint8, where

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Shares of linear red, green and blue in the luminance of Rec.709."""


def srgb_from_linear(linear: Tensor) -> Tensor:
    """sRGB in [0, 1] from linear Rec.709, any shape; values outside [0, 1] are clamped."""
    linear = linear.clamp(0.0, 1.0)
    # The lower clamp keeps the gradient of the power finite where the linear branch is taken.
    return where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp(min=0.0031308) ** (1 / 2.4) - 0.055)


def linear_from_srgb(srgb: Tensor) -> Tensor:
    """Linear Rec.709 in [0, 1] from sRGB, any shape; values outside [0, 1] are clamped."""
    srgb = srgb.clamp(0.0, 1.0)
    return where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def bytes_from_unit(values: Tensor) -> Tensor:
    """uint8 0 to 255 from [0, 1], any shape, rounded; values outside are clamped. The transfer function stays."""
    return (values.detach().clamp(0.0, 1.0) * 255.0).round().to(uint8)


def composite(color: Tensor, alpha: Tensor, background: float) -> Tensor:
    """`color` with straight `alpha` over a grey `background`; all in the same transfer function.

    Args:
        color: (..., 3, H, W).
        alpha: (..., 1, H, W) in [0, 1].
        background: grey level.
    """
    return color * alpha + background * (1.0 - alpha)
