"""A user's UVs as an atlas: kept wherever each texel belongs to one point of the surface."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ...graphics.raster.rasterize import Fragments, interpolate, rasterize_uv

_SMALLEST = 1e-4
"""Of the unit square, how much an atlas has to fill: less is a hundred texels of 1024 x 1024."""

_ROUNDING = 1e-3
"""UVs that leave the unit square, or a tile, by no more were meant to end there: a texel of 1024."""

_MOST_TILES = 100
"""Tiles side by side; more leave each too few texels."""

_SIDE = 1024
"""Texels a side at which overlaps are looked for."""

_SHARED = 2e-4
"""Of the covered texels, how many may belong to two places of the surface: charts that touch, not parts that lie over
one another."""

_APART = 2e-3
"""Of the mesh's extent: points further apart are two places."""


@dataclass(frozen=True)
class OwnUvs:
    """UVs that are an atlas.

    Attributes:
        uvs: (M, 2) float32 in [0, 1], v up.
        face_uvs: (F, 3) int64 into them.
        moved: how they were brought into the unit square; empty where they lay in it.
    """

    uvs: NDArray[Any]
    face_uvs: NDArray[Any]
    moved: str = ""


def own_uvs(vertices: NDArray[Any], faces: NDArray[Any], uvs: NDArray[Any], face_uvs: NDArray[Any]) -> OwnUvs | str:
    """The user's UVs inside the unit square, or why they are no atlas.

    Args:
        vertices: (N, 3) float32, welded.
        faces: (F, 3) int64 into them.
        uvs: (M, 2), v up, anywhere.
        face_uvs: (F, 3) int64 into them.
    """
    uvs = np.asarray(uvs, np.float64)
    if not np.isfinite(uvs[face_uvs]).all():
        return "some are no numbers"
    found = _in_unit_square(uvs[face_uvs])
    if isinstance(found, str):
        return found
    corners, moved = found
    a, b, c = np.moveaxis(corners, 1, 0)
    areas = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2.0
    if areas.sum() < _SMALLEST:
        return "they lie in one place"
    if moved:
        flat, numbers = np.unique(corners.reshape(-1, 2).astype(np.float32), axis=0, return_inverse=True)
        result = OwnUvs(flat, numbers.reshape(-1, 3), moved)
    else:
        result = OwnUvs(np.clip(uvs, 0.0, 1.0).astype(np.float32), face_uvs)
    own = [torch.from_numpy(array) for array in (vertices, faces, result.uvs, result.face_uvs)]
    shared = shared_texels(own[0], own[1], own[2], own[3])
    if shared > _SHARED:
        return f"{shared:.1%} of the texels would belong to several places of the surface, whose faces overlap there"
    return result


def _in_unit_square(corners: NDArray[Any]) -> tuple[NDArray[Any], str] | str:
    """(F, 3, 2) corners inside [0, 1] and how they were moved; or why they cannot be."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    if low.min() >= -_ROUNDING and high.max() <= 1.0 + _ROUNDING:
        return np.clip(corners, 0.0, 1.0), ""
    tile = np.floor(corners.min(axis=1) + _ROUNDING)
    if (corners.max(axis=1) <= tile + 1.0 + _ROUNDING).all():
        tiles, number = np.unique(tile, axis=0, return_inverse=True)
        if len(tiles) > _MOST_TILES:
            return f"they have {len(tiles)} tiles, more than {_MOST_TILES}"
        side = math.ceil(math.sqrt(len(tiles)))
        number = number.reshape(-1)
        cell = np.stack([number % side, number // side], axis=1)[:, None]
        inside = np.clip(corners - tile[:, None], 0.0, 1.0)
        what = "from their tile into that of 1001" if len(tiles) == 1 else f"from {len(tiles)} tiles (UDIM) into one"
        return (inside + cell) / side, f"moved {what}"
    extent = float((high - low).max())
    return np.clip((corners - low) / extent, 0.0, 1.0), f"scaled by {1.0 / extent:.3g} to fit into the unit square"


def shared_texels(
    vertices: torch.Tensor, faces: torch.Tensor, uvs: torch.Tensor, face_uvs: torch.Tensor, side: int = _SIDE
) -> float:
    """Of the texels that faces cover, the share that belongs to two places of the surface, or to both of its sides.

    Args: as of `own_uvs`.
        side: texels.
    """
    lowest = rasterize_uv(uvs, face_uvs, side)
    turned = rasterize_uv(uvs, face_uvs.flip(0), side)
    # Where several faces cover a texel, one order finds the first of them and the other the last.
    highest = Fragments(
        torch.where(turned.mask, len(face_uvs) - 1 - turned.face_id, -1), turned.barycentric, turned.depth
    )
    several = lowest.mask & (lowest.face_id != highest.face_id)
    if not bool(several.any()):
        return 0.0
    low, high = (interpolate(vertices, faces, fragments)[:, several] for fragments in (lowest, highest))
    extent = float((vertices.amax(dim=0) - vertices.amin(dim=0)).max())
    a, b, c = vertices[faces].unbind(dim=1)
    normals = torch.linalg.cross(b - a, c - a)
    against = (normals[lowest.face_id[several]] * normals[highest.face_id[several]]).sum(dim=1) < 0.0
    apart = ((low - high).norm(dim=0) > _APART * extent) | against
    shared = torch.zeros_like(several)
    shared[several] = apart
    # Texels along an edge that two charts share are covered twice; only what is wider counts.
    inner = torch.nn.functional.max_pool2d((~shared).float()[None, None], 3, 1, 1)[0, 0] < 0.5
    return float(inner.sum()) / float(lowest.mask.sum())
