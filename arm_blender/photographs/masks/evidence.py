"""What the cameras tell about each pixel of a mask: what all masks have in common, and what the ground looks like."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

from .eyes import Eye
from .ground_colors import GroundColors, ground_colors, unlike_ground

CHANNELS = 10
"""Of the evidence beside the colours."""

_CELLS, _HALF = 64, 1.5
"""Samples along a side of the space that is looked at, and half of that side, world units."""

_SURE = 4.0
"""Logit beyond which a mask is no surer."""

_LOW = 0.2
"""The share of the masks that may contradict all others."""

_ABOVE = 0.08
"""World units above the ground from which on a shadow is not taken for a part of the object."""

_DEPTHS, _MAP = 64, 64
"""Samples along a ray, and pixels a side at which rays are followed."""

_FILL = 0.7
"""Of a window's side, what the object takes along its longer side."""


@dataclass(frozen=True)
class Scene:
    """Pictures of one object by cameras that are known, and what their masks have in common.

    Attributes:
        pictures: (3, H, W) sRGB each.
        logits: (h, w) each: how sure the first look is that a pixel is the object.
        eyes: the cameras; the object lies about the origin, its longest side about 2, Z is up.
        support: (2, N, N, N) logits in space, [z, y, x]: of everything, and of what is clearly above the ground.
        ground: what it looks like, where its height is known.
        bottom: height at which `support` begins.
    """

    pictures: tuple[Tensor, ...]
    logits: tuple[Tensor, ...]
    eyes: tuple[Eye, ...]
    support: Tensor
    ground: GroundColors | None
    bottom: float


def scene(pictures: Sequence[Tensor], logits: Sequence[Tensor], eyes: Sequence[Eye], ground: float | None) -> Scene:
    """Put together what the pictures tell.

    Args:
        pictures, logits, eyes: as `Scene` has them.
        ground: height (Z) of what the object stands on; None where nobody knows.
    """
    bottom = -_HALF if ground is None else ground
    axis = (torch.arange(_CELLS) + 0.5) / _CELLS * 2.0 * _HALF
    z, y, x = torch.meshgrid(axis + bottom, axis - _HALF, axis - _HALF, indexing="ij")
    points = torch.stack([x, y, z], dim=-1)
    told = []
    for logit, eye in zip(logits, eyes, strict=True):
        place, inside = eye.places(points)
        flat = place.view(1, _CELLS * _CELLS, _CELLS, 2)
        read = grid_sample(logit[None, None].clamp(-_SURE, _SURE), flat, padding_mode="border", align_corners=False)
        told.append(torch.where(inside, read.view(inside.shape), torch.nan))
    all_told = torch.stack(told)
    seen = (~all_told.isnan()).sum(dim=0)
    both = 0.5 * (all_told.nanmean(dim=0) + _low(all_told, seen))
    support = torch.where(2 * seen >= len(told), both, -_SURE)
    above = support if ground is None else torch.where(z > ground + _ABOVE, support, -_SURE)
    colors = None
    if ground is not None:
        colors = ground_colors(pictures, eyes, [logit.sigmoid() for logit in logits], ground)
    return Scene(tuple(pictures), tuple(logits), tuple(eyes), torch.stack([support, above]), colors, bottom)


def _low(told: Tensor, seen: Tensor) -> Tensor:
    """The value (...) that `_LOW` of those told (V, ...) are below; NaN tells nothing."""
    ordered = torch.where(told.isnan(), torch.inf, told).sort(dim=0).values
    rank = (_LOW * (seen - 1).clamp(min=0)).round().long()[None]
    return ordered.gather(0, rank)[0].clamp(max=_SURE)


def window(scene: Scene, view: int) -> Tensor:
    """(4,) left, top, right and bottom of the square around the object in a picture, in the units of `Eye.places` but
    square in pixels; it may reach beyond the picture."""
    eye, logit = scene.eyes[view], scene.logits[view]
    half = logit.new_tensor([eye.lens.width, eye.lens.height]) / 2.0
    axis = (torch.arange(_CELLS) + 0.5) / _CELLS * 2.0 * _HALF
    index = torch.nonzero(scene.support[1] > 0.0)
    place = torch.zeros(0, 2)
    if len(index):
        points = torch.stack(
            [axis[index[:, 2]] - _HALF, axis[index[:, 1]] - _HALF, axis[index[:, 0]] + scene.bottom], -1
        )
        place, inside = eye.places(points)
        place = place[inside]
    if not len(place):  # Then the picture's own mask has to do.
        found = torch.nonzero(logit > 0.0).flip(1)
        size = found.new_tensor([logit.shape[1], logit.shape[0]])
        place = (found + 0.5) / size * 2.0 - 1.0 if len(found) else torch.tensor([[-1.0, -1.0], [1.0, 1.0]])
    low, high = (place * half).amin(dim=0), (place * half).amax(dim=0)
    middle, extent = (low + high) / 2.0, (high - low).max().clamp(min=16.0) / _FILL / 2.0
    return torch.cat([(middle - extent) / half, (middle + extent) / half])


def evidence(scene: Scene, view: int, box: Tensor, side: int) -> tuple[Tensor, Tensor]:
    """What is known about the pixels of a window of a picture.

    Args:
        box: (4,) as `window` gives it.
        side: pixels of the window.
    Returns:
        (3, side, side) sRGB, and (`CHANNELS`, side, side), about -1 to 1: 1 where the picture shows it; the first
        look's logit; the support in space, of all and above the ground; how unlike the ground's colour it is, how
        spread and how hidden the ground is there, and whether it is known; how far the ray passes from the axis, and at
        which height.
    """
    eye = scene.eyes[view]
    places = places_of(box, side)
    shown = (places.abs() < 1.0).all(dim=-1).float()[None]
    srgb = grid_sample(scene.pictures[view][None], places[None], padding_mode="border", align_corners=False)[0]
    first = scene.logits[view][None, None].clamp(-_SURE, _SURE)
    logit = grid_sample(first, places[None], padding_mode="border", align_corners=False)[0]
    if scene.ground is None:
        ground = torch.zeros(4, side, side)
    else:
        ground = unlike_ground(scene.ground, srgb, view, eye, places)
    ground = ground * ground.new_tensor([4.0, 10.0, 1.0, 1.0])[:, None, None]
    ray, center = eye.rays(places), eye.center.to(places)
    flat = ray[..., :2].square().sum(dim=-1).clamp(min=1e-6)
    nearest = center + (-(ray[..., :2] * center[:2]).sum(dim=-1) / flat)[..., None] * ray
    axis = torch.stack([nearest[..., :2].norm(dim=-1) / 2.0, nearest[..., 2] / 2.0])
    told = torch.cat([shown, logit / _SURE, _along_rays(scene, view, box, side) / _SURE, ground, axis])
    return srgb, told.clamp(-1.0, 1.0)


def _along_rays(scene: Scene, view: int, box: Tensor, side: int) -> Tensor:
    """(2, side, side): the largest support that each ray meets."""
    eye = scene.eyes[view]
    ray, center = eye.rays(places_of(box, _MAP)), eye.center.float()
    far = float(center.norm())
    depth = torch.linspace(max(far - 1.8 * _HALF, 0.05), far + 1.8 * _HALF, _DEPTHS)
    points = center + ray[..., None, :] * depth[:, None]  # (_MAP, _MAP, _DEPTHS, 3)
    grid = points / _HALF
    grid[..., 2] = (points[..., 2] - scene.bottom) / _HALF - 1.0
    shifted = (scene.support + _SURE)[None]  # Beyond the space there is nothing.
    met = grid_sample(shifted, grid[None], align_corners=False)[0].amax(dim=-1) - _SURE
    return interpolate(met[None], (side, side), mode="bilinear", align_corners=False)[0]


def places_of(box: Tensor, side: int) -> Tensor:
    """(side, side, 2) places of a window's pixels."""
    along = (torch.arange(side) + 0.5) / side
    x, y = box[0] + along * (box[2] - box[0]), box[1] + along * (box[3] - box[1])
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
