"""The windows of views: a square around the object, as much of it inside its photograph as there is."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, max_pool2d

from ..views.masks import without_specks
from .undistort import RayTable

_MARGIN = 0.1
"""Of the object's longer side, at each side of the window: the networks want to see that it ends."""

_RING = 2
"""Pixels along the border of a picture: a mask that lies there is cut."""

_CUT = 0.02
"""Of the longer side of the object's box, how much of the mask may lie along the border."""


@dataclass(frozen=True)
class Window:
    """The picture of a pinhole.

    Attributes:
        K: (3, 3) float64, pixels.
        width: pixels.
        height: pixels.
    """

    K: Tensor
    width: int
    height: int

    def square(self, left: float, top: float, extent: float, side: int) -> "Window":
        """The square of `extent` pixels of this picture from (left, top), drawn with `side` pixels."""
        scale = side / extent
        K = self.K.clone()
        K[0, 2] -= left
        K[1, 2] -= top
        K[:2] *= scale
        return Window(K, side, side)

    def resized(self, side: int) -> "Window":
        """The same square with `side` pixels a side."""
        return self.square(0.0, 0.0, float(self.width), side)

    def of(self, values: Tensor, other: "Window") -> Tensor:
        """`values` (H, W) of the picture of `other` as this one shows them; 0 beyond it."""
        x = (torch.arange(self.width, dtype=torch.float64) + 0.5 - self.K[0, 2]) / self.K[0, 0]
        y = (torch.arange(self.height, dtype=torch.float64) + 0.5 - self.K[1, 2]) / self.K[1, 1]
        x = (x * other.K[0, 0] + other.K[0, 2]) / other.width * 2.0 - 1.0
        y = (y * other.K[1, 1] + other.K[1, 2]) / other.height * 2.0 - 1.0
        grid = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).to(values.dtype)
        return grid_sample(values[None, None], grid[None], padding_mode="zeros", align_corners=False)[0, 0]


def whole_window(table: RayTable, longest: int) -> Window:
    """All that a lens sees, without distortion; at most `longest` pixels a side, square pixels."""
    left, top, right, bottom = table.bounds
    focal = longest / max(right - left, bottom - top)
    K = torch.tensor([[focal, 0.0, -left * focal], [0.0, focal, -top * focal], [0.0, 0.0, 1.0]], dtype=torch.float64)
    return Window(K, max(1, round((right - left) * focal)), max(1, round((bottom - top) * focal)))


def around(whole: Window, alpha: Tensor, known: Tensor, side: int) -> Window:
    """The square window around the object, with `side` pixels a side.

    It is moved, and its margin given up, before it reaches beyond the photograph: what lies there nobody knows.

    Args:
        whole: all that the photograph shows.
        alpha: (H, W) of that, with something in it.
        known: (H, W) bool: pixels that the photograph has.
        side: pixels of the window.
    """
    top, bottom, left, right = _box(without_specks(alpha > 0.5))
    first_row, last_row, first_column, last_column = _box(known)
    longest = max(bottom - top, right - left)
    shorter = min(last_row - first_row, last_column - first_column)
    extent = max(longest, min(round(longest * (1.0 + 2.0 * _MARGIN)), shorter))
    start_x = _inside((left + right - extent) / 2.0, extent, first_column, last_column)
    start_y = _inside((top + bottom - extent) / 2.0, extent, first_row, last_row)
    return whole.square(start_x, start_y, float(extent), side)


def is_cut(alpha: Tensor, known: Tensor) -> bool:
    """Whether the object of `alpha` (H, W) goes on beyond the pixels that are `known` (H, W) bool."""
    mask = without_specks(alpha > 0.5) & known
    if not bool(mask.any()):
        return False
    unknown = torch.nn.functional.pad((~known).float()[None, None], (_RING,) * 4, value=1.0)
    ring = max_pool2d(unknown, 2 * _RING + 1, stride=1)[0, 0] > 0.0
    along = (mask & ring & known).sum() / _RING
    top, bottom, left, right = _box(mask)
    return float(along) > max(3.0, _CUT * max(bottom - top, right - left))


def known_rectangle(known: Tensor) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of a rectangle in which every pixel of `known` (H, W) is true; the last two exclusive.

    From the box of all of them the side with most unknown pixels goes in, row by row: the border of an undistorted
    picture is bent, and only slightly.
    """
    top, bottom, left, right = _box(known) if bool(known.any()) else (0, 0, 0, 0)
    while top < bottom and left < right:
        sides = {
            "top": known[top, left:right],
            "bottom": known[bottom - 1, left:right],
            "left": known[top:bottom, left],
            "right": known[top:bottom, right - 1],
        }
        gaps = {name: float((~line).float().mean()) for name, line in sides.items()}
        worst = max(gaps, key=lambda name: gaps[name])
        if gaps[worst] == 0.0:
            break
        top, left = top + (worst == "top"), left + (worst == "left")
        bottom, right = bottom - (worst == "bottom"), right - (worst == "right")
    return left, top, right, bottom


def _box(mask: Tensor) -> tuple[int, int, int, int]:
    """Top, bottom, left, right of what is true in `mask` (H, W); bottom and right exclusive."""
    rows, columns = (torch.nonzero(mask.any(dim=dim))[:, 0] for dim in (1, 0))
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


def _inside(start: float, extent: int, first: int, last: int) -> float:
    """`start` of a window of `extent`, moved between `first` and `last` where it fits, else centred on them."""
    if extent > last - first:
        return (first + last - extent) / 2.0
    return float(min(max(start, first), last - extent))
