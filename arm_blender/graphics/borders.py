"""Where pictures end: what lies beyond a border is unknown where the object is cut by it, and empty elsewhere."""

import math

import torch
from torch import Tensor

CUT = 2
"""Opaque pixels along a border from which on the object is cut there: a speck is not."""

Rectangle = tuple[int, int, int, int]
"""Left, top, right and bottom of the pixels that a camera took; right and bottom are beyond the last."""


def cut_sides(alpha: Tensor, known: Rectangle) -> tuple[bool, bool, bool, bool]:
    """Whether the object of `alpha` (H, W) is cut at the left, top, right and bottom of the known pixels."""
    left, top, right, bottom = known
    inside = alpha[top:bottom, left:right] > 0.5
    edges = inside[:, 0], inside[0], inside[:, -1], inside[-1]
    first, second, third, fourth = (int(edge.sum()) >= CUT for edge in edges)
    return first, second, third, fourth


def scaled(known: Rectangle, across: float, down: float | None = None) -> Rectangle:
    """The rectangle in a picture scaled by `across` and `down` (alike where that is None).

    Pixels that it holds in part are left out; at least one stays.
    """
    down = across if down is None else down
    left, top = math.ceil(known[0] * across - 1e-6), math.ceil(known[1] * down - 1e-6)
    right, bottom = math.floor(known[2] * across + 1e-6), math.floor(known[3] * down + 1e-6)
    return left, top, max(right, left + 1), max(bottom, top + 1)


def continued(image: Tensor, known: Rectangle) -> tuple[Tensor, Tensor]:
    """A picture that goes on beyond the borders that cut its object as it ends there.

    So a distance to the outline does not take the border for one.

    Args:
        image: (4, H, W), alpha last; transparent outside of `known`.
    Returns:
        (4, H, W), `image` itself where nothing is cut; and (4,) left, top, right and bottom of what the picture tells,
        its ends being -1 and 1: infinite where a border cuts nothing, for then nothing is beyond it, however far.
    """
    cut = cut_sides(image[3], known)
    height, width = image.shape[1:]
    told = torch.tensor([-torch.inf, -torch.inf, torch.inf, torch.inf])
    if not any(cut):
        return image, told
    left, top, right, bottom = known
    image = image.clone()
    if cut[0]:
        image[:, :, :left] = image[:, :, left : left + 1]
    if cut[2]:
        image[:, :, right:] = image[:, :, right - 1 : right]
    if cut[1]:
        image[:, :top] = image[:, top : top + 1]
    if cut[3]:
        image[:, bottom:] = image[:, bottom - 1 : bottom]
    size = torch.tensor([width, height, width, height])
    ends = 2.0 * torch.tensor(known) / size - 1.0
    return image, torch.where(torch.tensor(cut), ends, told)
