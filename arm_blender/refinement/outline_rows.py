"""Where a mesh and the outlines of its pictures part: equations for a displacement along the normals."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from ..graphics.raster.rasterize import Fragments
from .picture_evidence import PictureEvidence

MOST_GAP = 8.0
"""Fine pixels that an equation asks for at most; the rest is left to the next round."""

FORGIVEN = 12.0
"""Fine pixels of a gap at which an equation counts half: masks have holes and tongues, and objects parts that no
displacement makes."""

STEEP = 0.4
"""Cosine between a normal and the picture's plane below which an equation says too little of the vertex."""

BESIDE_WEIGHT, BESIDE = 0.5, 0.6
"""How much a vertex that lies outside of an outline counts, and from how many fine pixels on it does."""


@dataclass(frozen=True)
class OutlineRows:
    """P equations `cosine` * (displacement of `vertex`) = `gap`, of one view.

    Attributes:
        vertex: (P,) int64.
        cosine: (P,) of the vertex's normal with the way out of the outline.
        gap: (P,) world units to go outwards.
        weight: (P,) >= 0.
        error: mean distance between the two outlines, fine pixels; 0 where there is nothing to measure.
    """

    vertex: Tensor
    cosine: Tensor
    gap: Tensor
    weight: Tensor
    error: float

    def trusted(self, share: float) -> "OutlineRows":
        """The same on the CPU, counting `share` as much."""
        vertex, cosine, gap, weight = (part.cpu() for part in (self.vertex, self.cosine, self.gap, self.weight))
        return OutlineRows(vertex, cosine, gap, share * weight, self.error)


def outline_rows(
    vertices: Tensor, normals: Tensor, faces: Tensor, fragments: Fragments, view: PictureEvidence
) -> OutlineRows:
    """Of one view.

    Args:
        vertices: (N, 3). normals: (N, 3) unit. faces: (F, 3).
        fragments: what the view's `outline_camera` sees of the mesh.
    """
    row, column = _contour(fragments.mask).nonzero(as_tuple=True)
    told = view.tells(torch.stack([column, row], dim=1) + 0.5)
    row, column = row[told], column[told]
    nearest = fragments.barycentric[:, row, column].argmax(dim=0)
    vertex = faces[fragments.face_id[row, column], nearest]
    # The outline of the mesh runs a quarter to half a pixel beyond the centre of its last pixel.
    gap = view.distance[row, column] - 0.5
    error = float(gap.abs().mean()) if len(gap) else 0.0
    cosine, steep = _outwards(view, view.slope[:, row, column].T, normals[vertex])
    pixel = fragments.depth[row, column] / view.outline_camera.K[0, 0]
    weight = steep / (1.0 + (gap / FORGIVEN).square())

    distance, slope, depth = view.at_outline(vertices)
    beside = (distance < -BESIDE).nonzero()[:, 0]
    cosine_beside, steep_beside = _outwards(view, slope[beside], normals[beside])
    gap_beside = distance[beside]
    weight_beside = BESIDE_WEIGHT * steep_beside / (1.0 + (gap_beside / FORGIVEN).square())
    pixel_beside = depth[beside] / view.outline_camera.K[0, 0]
    return OutlineRows(
        torch.cat([vertex, beside]),
        torch.cat([cosine, cosine_beside]),
        torch.cat([gap.clamp(-MOST_GAP, MOST_GAP) * pixel, gap_beside.clamp(min=-MOST_GAP) * pixel_beside]),
        torch.cat([weight, weight_beside]),
        error,
    )


def _contour(mask: Tensor) -> Tensor:
    """(H, W) bool: pixels of a mask that touch what is outside of it; the picture's border is no outside."""
    outside = (~mask).float()[None, None]
    return mask & (F.max_pool2d(outside, 3, stride=1, padding=1)[0, 0] > 0.0)


def _outwards(view: PictureEvidence, slope: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """(P,) cosine of unit normals (P, 3) with the way out of the outline, and (P,) 1 where that says enough, else 0."""
    out = -F.normalize(slope, dim=1)
    right, up = view.outline_camera.c2w[:3, :2].T
    cosine = ((out[:, :1] * right - out[:, 1:] * up) * normals).sum(dim=1)
    return cosine, ((slope.norm(dim=1) > 0.25) & (cosine.abs() > STEEP)).to(cosine)
