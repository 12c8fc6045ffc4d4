"""What masks have in common in space: where they disagree, the cameras are wrong, or the masks are."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from ..capture import Lens
from .eyes import Eye

_CELLS = 72
"""Samples a side of the grid."""

_SIDE = 128
"""Pixels of the longer side of the masks that are looked at."""

_SUPPORT, _CORE = 0.9, 0.95
"""Of the pictures that see a point, how many masks must hold it: a bad mask or two of twenty carve nothing away."""


@dataclass(frozen=True)
class JointHull:
    """The hull that most masks support.

    Attributes:
        points: (P, 3) float64, samples of its inside; none where the masks meet nowhere.
        core: those of them that nearly all masks support, for the object's size; all, where the masks do not agree.
        cell: between samples.
        agreement: (V,) of each picture with a mask, how much its mask and the hull's picture have in common, in [0, 1].
    """

    points: Tensor
    core: Tensor
    cell: float
    agreement: Tensor


@dataclass(frozen=True)
class _Look:
    """A camera and its mask at a lower resolution."""

    eye: Eye
    mask: Tensor

    def places(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """(P,) pixel of the mask, row by row, and (P,) bool: it is in the picture."""
        place, inside = self.eye.places(points)
        height, width = self.mask.shape
        column, row = (
            ((place + 1.0) / 2.0 * place.new_tensor([width, height])).clamp(-1.0, 1e6).floor().long().unbind(-1)
        )
        return row.clamp(0, height - 1) * width + column.clamp(0, width - 1), inside


def joint_hull(w2c: Tensor, lenses: tuple[Lens, ...], masks: list[Tensor]) -> JointHull:
    """The hull of masks.

    Args:
        w2c: (V, 4, 4) float64, OpenCV axes.
        lenses: of the V cameras; their first parameters are one focal length and the centre.
        masks: V of (H, W) float, the object's alpha; each shows something.
    """
    looks = [_Look(Eye(one, lens), _small(mask)) for one, lens, mask in zip(w2c, lenses, masks, strict=True)]
    center = meeting_point(looks)
    # The grid is as large as the masks say at the distance of the middle; then once more around what it found.
    reach = max(_span(look) * float((look.eye.w2c[:3, :3] @ center + look.eye.w2c[:3, 3])[2].abs()) for look in looks)
    low, high = center - 0.75 * reach, center + 0.75 * reach
    points, core, cell = center.new_zeros(0, 3), center.new_zeros(0, 3), 0.0
    for _ in range(2):
        cell = float((high - low).max()) / (_CELLS - 1)
        if not (math.isfinite(cell) and cell > 0.0):
            break
        axes = [
            torch.arange(float(a), float(b) + cell / 2, cell, dtype=torch.float64)
            for a, b in zip(low, high, strict=True)
        ]
        points = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).view(-1, 3)
        support = _support(points, looks)
        core, points = points[support >= _CORE], points[support >= _SUPPORT]
        if not len(points):
            break
        low, high = points.amin(dim=0) - cell, points.amax(dim=0) + cell
    core = core if len(core) > len(points) // 4 else points
    return JointHull(points, core, cell, torch.tensor([_agreement(points, cell, look) for look in looks]))


def meeting_point(looks: list[_Look]) -> Tensor:
    """(3,) nearest to the rays through the masks' middles."""
    system, right = torch.zeros(3, 3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    for look in looks:
        height, width = look.mask.shape
        middle = torch.nonzero(look.mask > 0.5).double().mean(dim=0).flip(0) + 0.5
        ray = look.eye.rays(middle / middle.new_tensor([width, height]) * 2.0 - 1.0)
        across = torch.eye(3, dtype=torch.float64) - torch.outer(ray, ray)
        system += across
        right += across @ look.eye.center
    return torch.linalg.lstsq(system, right[:, None], driver="gelsd").solution[:, 0]


def _small(mask: Tensor) -> Tensor:
    scale = min(1.0, _SIDE / max(mask.shape))
    size = max(1, round(mask.shape[0] * scale)), max(1, round(mask.shape[1] * scale))
    return adaptive_avg_pool2d(mask[None, None].float(), size)[0, 0]


def _span(look: _Look) -> float:
    """Of a mask, the longer side at a distance of 1."""
    pixels = torch.nonzero(look.mask > 0.5)
    extent = float((pixels.amax(dim=0) - pixels.amin(dim=0)).max() + 1) if len(pixels) else 0.0
    return extent * look.eye.lens.width / look.mask.shape[1] / look.eye.lens.parameters[0]


def _support(points: Tensor, looks: list[_Look]) -> Tensor:
    """(P,) of the pictures that see each point, the share whose masks hold it; 0 where fewer than half see it."""
    seen, held = torch.zeros(len(points)), torch.zeros(len(points))
    for look in looks:
        place, inside = look.places(points)
        seen += inside
        held += inside & (look.mask > 0.5).flatten()[place]
    return torch.where(seen >= max(2.0, 0.5 * len(looks)), held / seen.clamp(min=1.0), torch.zeros_like(seen))


def _agreement(points: Tensor, cell: float, look: _Look) -> float:
    """Intersection over union of the mask and the picture of the hull, inside the picture."""
    mask = look.mask > 0.5
    drawn = torch.zeros(mask.numel(), dtype=torch.bool)
    # The corners of each cell, so that no gaps are between them.
    for corner in torch.cartesian_prod(*[torch.tensor([-0.4, 0.4], dtype=torch.float64)] * 3):
        place, inside = look.places(points + corner * cell)
        drawn[place[inside]] = True
    drawn = drawn.view(mask.shape)
    return float((drawn & mask).sum()) / max(1.0, float((drawn | mask).sum()))
