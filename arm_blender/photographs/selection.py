"""Which of many photographs become views: those that see the object sharp, whole and from all around."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import conv2d, interpolate, normalize

_SHARPNESS_SIDE = 512
"""Pixels of the square in which sharpness is measured: as fine as a view of the object will be, no finer."""

_NEIGHBOURS = 4
"""Photographs from about the same direction that one is compared with: they see the same thing."""

BLURRED = 0.25
"""Of the sharpness of its neighbours: below it a photograph only serves where there is no other. On 20 captures of
training objects 5 % of the sharp pictures are below it, where others see more detail, and 78 % of shaken ones."""

ENOUGH = 8
"""Views: where there are so many, no blurred one is taken."""


@dataclass(frozen=True)
class Candidate:
    """A photograph that may become a view.

    Attributes:
        direction: (3,) float64 unit, from the object to the camera.
        sharpness: of the object, beside that of its neighbours; 1 is as sharp as they are.
    """

    direction: Tensor
    sharpness: float

    @property
    def weight(self) -> float:
        """How much its direction counts, in (0, 1]."""
        return min(1.0, max(0.05, self.sharpness))


def next_view(candidates: Mapping[int, Candidate], chosen: Sequence[int], left: Sequence[int]) -> int:
    """The one of `left` that adds most to those `chosen`: far from all of them, and sharp.

    Args:
        candidates: all of them.
        chosen: indices, may be none: the sharpest is first then.
        left: indices, at least one.
    """
    if not chosen:
        return max(left, key=lambda index: candidates[index].sharpness)
    taken = torch.stack([candidates[index].direction for index in chosen])

    def gain(index: int) -> float:
        nearest = float((taken @ candidates[index].direction).max())
        return math.acos(max(-1.0, min(1.0, nearest))) * candidates[index].weight

    return max(left, key=gain)


def object_center(c2ws: Tensor) -> Tensor:
    """(3,) the point that is nearest to the axes of all cameras (N, 4, 4), in the sense of least squares."""
    eyes, axes = c2ws[:, :3, 3], normalize(-c2ws[:, :3, 2], dim=-1)
    across = torch.eye(3, dtype=c2ws.dtype) - axes[:, :, None] * axes[:, None]
    # Parallel axes leave the system singular: the solution of least norm, counted from the cameras' middle.
    middle = eyes.mean(dim=0)
    right = (across @ (eyes - middle)[..., None]).sum(dim=0)
    return middle + torch.linalg.lstsq(across.sum(dim=0), right, driver="gelsd").solution[:, 0]


def directions_from(center: Tensor, c2ws: Tensor) -> Tensor:
    """(N, 3) unit, from `center` (3,) to the cameras (N, 4, 4)."""
    return normalize(c2ws[:, :3, 3] - center, dim=-1)


def sharpness(image: Tensor, place: tuple[float, float]) -> float:
    """Variance of the Laplacian beside that of the grey levels, of the object in a photograph; light cancels out.

    Args:
        image: (1, H, W) grey levels, sRGB.
        place: of the object: shares of width and height.
    """
    height, width = image.shape[1:]
    side = max(1, min(height, width) // 2)
    left = min(max(round(place[0] * width) - side // 2, 0), width - side)
    top = min(max(round(place[1] * height) - side // 2, 0), height - side)
    window = image[None, :, top : top + side, left : left + side]
    if side > _SHARPNESS_SIDE:
        window = interpolate(window, size=(_SHARPNESS_SIDE, _SHARPNESS_SIDE), mode="area")
    kernel = torch.tensor([[0.0, 1.0, 0.0], [1.0, -4.0, 1.0], [0.0, 1.0, 0.0]])[None, None]
    return float(conv2d(window, kernel).var(correction=0) / window.var(correction=0).clamp(min=1e-6))


def beside_neighbours(values: Sequence[float], directions: Tensor) -> list[float]:
    """`values` over the median of those whose `directions` (N, 3) are nearest; 1 where there is nothing to compare."""
    measured = torch.tensor(values, dtype=torch.float64)
    if len(measured) < 2:
        return [1.0] * len(measured)
    near = (directions @ directions.T).fill_diagonal_(-2.0).topk(min(_NEIGHBOURS, len(measured) - 1)).indices
    # The upper one of two: a blurred neighbour makes nobody sharp.
    usual = measured[near].quantile(0.5, dim=1, interpolation="higher")
    return (measured / usual.clamp(min=1e-12)).clamp(max=1e3).tolist()
