"""Masks across pictures: what the others carve away is no object, and a mask that carves what they all keep is wrong.

Every mask but one makes a hull; that one is held against it. A few masks may dissent, for they may be wrong too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from ...graphics.borders import Rectangle, continued
from ...graphics.cameras import Camera
from ...graphics.visual_hull import Outlines, signed_silhouette_distance
from ...graphics.windows import highest_around, lowest_around
from ...progress import Progress, silent

_CELLS, _HALF = 80, 1.5
"""Samples along a side of what is looked at, and half of that side, world units: where masks are wrong, so is the size
of the object that was taken from them, and half of it may lie beyond [-1, 1]^3."""

_OUTLINE_SIDE = 128
"""Pixels a side at which distances to outlines are found."""

_SLACK = 0.02
"""World units by which outlines may differ: cameras and masks are never exact."""

_DISSENT = 0.15
"""Of the other masks, how many may carve a place away that the rest keeps."""

_SPECK = 0.01
"""Of a mask's pixels, how many may lie outside of the others' hull before a word is lost about it."""

_HELD = 0.8
"""Of what the others' hull shows in a picture, how much its mask must hold to be mended, however much else it holds."""

_LACKING = 0.08
"""Of the hull of the others, the share that one mask alone may carve away: what only it can see, such as a hole."""

_ALIKE, _CLEAN_SHARE = 0.2, 0.25
"""Masks of which less than that share lies outside agree as they are. Where fewer than a quarter do, none is right."""

_FEWEST = 4
"""Masks below which nothing can be told."""


@dataclass(frozen=True)
class Agreement:
    """What became of the masks.

    Attributes:
        masks: (V, 1, S, S) as they were given, or mended.
        words: of each view that was mended or should be dropped, why.
        dropped: views whose masks should carve nothing.
    """

    masks: Tensor
    words: dict[int, str]
    dropped: tuple[int, ...]


def agreed(
    masks: Tensor,
    cameras: Sequence[Camera],
    progress: Progress = silent,
    ground: float | None = None,
    known: Sequence[Rectangle] | None = None,
) -> Agreement:
    """Mend or drop what most other masks contradict.

    Args:
        masks: (V, 1, S, S) alpha in [0, 1].
        cameras: V of them, of S x S pixels; the object lies about the origin, its longest side about 2.
        progress: is told about each view.
        ground: height (Z) of what the object stands on: a shadow that lies there is no object, however many masks
            show it.
        known: the pixels of each that a camera took. Where they cut the object, nobody knows what is beyond; elsewhere
            it is background. None takes them all.
    Raises:
        ValueError: shapes differ.
    """
    count, side = len(masks), masks.shape[-1]
    if masks.shape != (count, 1, side, side) or len(cameras) != count:
        raise ValueError(f"masks must be (V, 1, S, S) of V cameras, got {tuple(masks.shape)}, {len(cameras)} cameras")
    if count < _FEWEST:
        return Agreement(masks, {}, ())
    points, known = _grid(ground), known or [(0, 0, side, side)] * count
    outside, framed = _carved(masks, cameras, points, known)
    carving = outside.int().sum(dim=0)  # (P,)
    seen = framed.int().sum(dim=0)
    mended, words, dropped, clean = masks.clone(), dict[int, str](), list[int](), 0
    for view in range(count):
        progress(view / count, "comparing masks")
        others = carving - outside[view].int()
        # What hardly anybody frames is not known.
        kept = (others <= _DISSENT * (seen - framed[view].int())) & (seen >= count / 2)
        lacking = float((kept & (others == 0) & outside[view]).sum()) / max(1.0, float(kept.sum()))
        possible, certain = _shown(points[kept], cameras[view])
        left, top, right, bottom = known[view]
        certain = certain * pad(torch.ones(bottom - top, right - left), (left, side - right, top, side - bottom))
        mask = masks[view, 0]
        excess = float((mask * (1.0 - possible)).sum()) / max(1e-6, float(mask.sum()))
        held = float((mask * certain).sum()) / max(1e-6, float(certain.sum()))
        clean += excess < _ALIKE and lacking < _LACKING
        if lacking > _LACKING:
            words[view] = f"its mask lacks a part that the others show ({lacking:.0%} of the shape)"
            dropped.append(view)
        elif excess > _SPECK and held < _HELD:
            words[view] = f"its mask is not of what the others show ({excess:.0%} of it lies elsewhere)"
            dropped.append(view)
        elif excess > _SPECK:
            words[view] = f"{excess:.0%} of its mask, which the others contradict, was taken away"
            mended[view, 0] = mask * possible
    if clean < _CLEAN_SHARE * count or 2 * len(dropped) > count:
        # Then the cameras are wrong, or the thing was moved: no majority is left to believe.
        return Agreement(masks, dict.fromkeys(words, "the masks contradict each other; nothing was mended"), ())
    return Agreement(mended, words, tuple(dropped))


def _grid(ground: float | None) -> Tensor:
    """(P, 3) points of what is looked at, a cell above the ground at least."""
    axis = _HALF * ((torch.arange(_CELLS) + 0.5) / _CELLS * 2.0 - 1.0)
    up = axis if ground is None else axis[axis > ground + 2.0 * _HALF / _CELLS]
    return torch.stack(torch.meshgrid(axis, axis, up, indexing="ij"), dim=-1).view(-1, 3)


def _carved(
    masks: Tensor, cameras: Sequence[Camera], points: Tensor, known: Sequence[Rectangle]
) -> tuple[Tensor, Tensor]:
    """(V, P) bool each: a mask carves a point away; a picture frames it."""
    shown = [continued(mask.float().expand(4, -1, -1), own) for mask, own in zip(masks, known, strict=True)]
    whole, told = torch.stack([image[3:] for image, _ in shown]), torch.stack([ends for _, ends in shown])
    small = interpolate(whole, (_OUTLINE_SIDE, _OUTLINE_SIDE), mode="area")[:, 0]
    silhouette = torch.stack([small, signed_silhouette_distance(small)], dim=1)
    outside, framed = [], []
    for view, camera in enumerate(cameras):
        own = camera.resized(_OUTLINE_SIDE, _OUTLINE_SIDE)
        placed = own.c2w[None, None].float(), own.K[None, None].float()
        outlines = Outlines(silhouette[None, view : view + 1], *placed, told[None, view : view + 1])
        seen = outlines.project(points[None])
        distance = outlines.read(seen)[1][0, 0]
        framed.append(seen.framed[0, 0] > 0.0)
        outside.append((distance < -_SLACK) & framed[-1])
    return torch.stack(outside), torch.stack(framed)


def _shown(points: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """(S, S) in [0, 1] each: where points (P, 3), a cell apart, may show a solid in a picture, and where they must."""
    side = _OUTLINE_SIDE  # A pixel is about as large as a cell, or a little less.
    own = camera.resized(side, side)
    drawn = torch.zeros(side, side)
    if len(points):
        empty = torch.zeros(1, 1, 2, side, side)
        seen = Outlines(empty, own.c2w[None, None].float(), own.K[None, None].float()).project(points[None])
        place = ((seen.grid[0, 0] + 1.0) / 2.0 * side).floor().long().clamp(0, side - 1)[seen.framed[0, 0] > 0.0]
        drawn[place[:, 1], place[:, 0]] = 1.0
    near = highest_around(drawn, 1)
    both = torch.stack([near, lowest_around(near, 3)])[None]
    possible, certain = interpolate(both, (camera.height, camera.width), mode="bilinear", align_corners=False)[0]
    return possible, certain
