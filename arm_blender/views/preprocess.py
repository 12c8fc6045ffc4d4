"""From pictures to views: the crop of a single picture, sizes, empty views."""

from pathlib import Path

import torch
from torch import Tensor

from ..errors import InputImageError
from ..graphics.borders import Rectangle, scaled
from .masks import sees_something

FOREGROUND_RATIO = 0.85
"""Of the square crop of a single picture, how much its object's longer side takes: as Zero123++ was trained."""

MAXIMUM_SIDE = 2048
"""Pixels a side that a view keeps; beyond it no atlas that we make can hold more detail."""

MINIMUM_SIDE = 16
"""Pixels a side below which a view says nothing."""


def check_size(image: Tensor, path: Path) -> None:
    """Raises `InputImageError` where `image` (4, H, W) is smaller than `MINIMUM_SIDE`."""
    height, width = image.shape[1:]
    if min(height, width) < MINIMUM_SIDE:
        raise InputImageError(f"{path}: {width}x{height} pixels; give at least {MINIMUM_SIDE} a side")


def limit_size(image: Tensor, path: Path) -> Tensor:
    """`image` (4, H, W), averaged down where it is larger than `MAXIMUM_SIDE`.

    Raises:
        InputImageError: smaller than `MINIMUM_SIDE`.
    """
    check_size(image, path)
    height, width = image.shape[1:]
    if max(height, width) <= MAXIMUM_SIDE:
        return image
    scale = MAXIMUM_SIDE / max(height, width)
    return _resized(image, max(1, round(height * scale)), max(1, round(width * scale)))


def crop_single(image: Tensor, path: Path) -> tuple[Tensor, float, Rectangle]:
    """The square window around the object of a single picture, at `FOREGROUND_RATIO`.

    Args:
        image: (4, H, W) linear, with a foreground.
        path: for the message.
    Returns:
        (4, S, S), transparent where the window reaches beyond the picture; the longer side of the object's bounding
        box in its pixels; and the pixels that are of the picture.
    Raises:
        InputImageError: nothing is opaque.
    """
    if not sees_something(image[3]):
        raise InputImageError(f"{path}: the mask is empty; supply an image whose alpha shows the object")
    rows, columns = (torch.nonzero((image[3] > 0.5).any(dim=dim))[:, 0] for dim in (1, 0))
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    left, right = int(columns[0]), int(columns[-1]) + 1
    longest = max(bottom - top, right - left)
    # An even remainder on each side keeps the window's centre on the box's centre, to half a pixel.
    side = max(round(longest / FOREGROUND_RATIO), longest)
    window_left, window_top = (left + right - side) // 2, (top + bottom - side) // 2
    window = image.new_zeros(4, side, side)
    height, width = image.shape[1:]
    source_top, source_left = max(window_top, 0), max(window_left, 0)
    source = image[:, source_top : min(window_top + side, height), source_left : min(window_left + side, width)]
    window_row, window_column = source_top - window_top, source_left - window_left
    window[:, window_row : window_row + source.shape[1], window_column : window_column + source.shape[2]] = source
    limited = limit_size(window, path)
    scale = limited.shape[1] / side
    own = window_column, window_row, window_column + source.shape[2], window_row + source.shape[1]
    return limited, longest * scale, scaled(own, scale)


def same_size(images: list[Tensor], paths: list[Path]) -> None:
    """Raises `InputImageError`, naming the first view whose size differs from the first one's."""
    for image, path in zip(images, paths, strict=True):
        if image.shape != images[0].shape:
            sizes = " and ".join(f"{i.shape[2]}x{i.shape[1]}" for i in (image, images[0]))
            raise InputImageError(f"{path}: views of different sizes ({sizes}); scale or crop all to one size")


def seeing_views(images: list[Tensor], paths: list[Path]) -> list[int]:
    """The indices of the views (4, H, W) that show something; the others have nothing to say.

    Raises:
        InputImageError: none does.
    """
    seeing = [index for index, image in enumerate(images) if sees_something(image[3])]
    if not seeing:
        raise InputImageError(f"{paths[0]}: the mask is empty in every view; supply images whose alpha shows it")
    return seeing


def _resized(image: Tensor, height: int, width: int) -> Tensor:
    """`image` (4, H, W) averaged down to another size; premultiplied on the way, so that no background leaks in."""

    def averaged(channel: Tensor) -> Tensor:
        return torch.nn.functional.interpolate(channel[None, None], size=(height, width), mode="area")[0]

    alpha = averaged(image[3])
    # One channel after the other: all of them premultiplied would be a second picture.
    color = torch.cat([averaged(channel * image[3]) for channel in image[:3]])
    return torch.cat([color / alpha.clamp(min=1e-6), alpha]).clamp(0.0, 1.0)
