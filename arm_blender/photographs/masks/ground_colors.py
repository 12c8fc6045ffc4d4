"""What the ground looks like, and which pixels look like it: what stands on it hides another part in every picture.

Colours of a place on the ground, a shadow on it included, are alike in all pictures that see it; those of an object
that hides it are not. The median over the pictures is the ground without what stands on it (as background subtraction
does over time).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample

from .eyes import Eye

REACH = 2.6
"""World units from the axis that are looked at; the object's longest side is 2."""

_CELLS = 256
"""Along a side of the ground's picture: a cell is a pixel or two of the pictures."""

_UNMASKED = 3
"""Pictures in which nothing hides a place that are enough to ask only those."""

_ROUNDS = 2
"""Of gains and colours, in turn."""

_DARKEST = 0.03
"""sRGB below which a colour tells no gain."""


@dataclass(frozen=True)
class GroundColors:
    """The ground around the object, seen from above.

    Attributes:
        colors: (3, N, N) sRGB; rows are Y, columns X, from -`REACH` to `REACH`.
        spread: (1, N, N) how far the pictures' colours lie from it, the median.
        hidden: (1, N, N) how likely it is that the object covers it, the mean over the pictures that see it.
        seen: (1, N, N) 1 where at least two pictures see it, else 0.
        gains: (V, 3) by which the pictures' colours are multiplied to be alike.
        height: of the ground (Z).
    """

    colors: Tensor
    spread: Tensor
    hidden: Tensor
    seen: Tensor
    gains: Tensor
    height: float

    def at(self, points: Tensor) -> Tensor:
        """(6, H, W) of points (H, W, 3) on the ground: colours, spread, hidden and seen; 0 beyond its picture."""
        layers = torch.cat([self.colors, self.spread, self.hidden, self.seen])
        return grid_sample(layers[None], points[None, ..., :2] / REACH, align_corners=False)[0]


def ground_colors(
    pictures: Sequence[Tensor], eyes: Sequence[Eye], probabilities: Sequence[Tensor], height: float
) -> GroundColors:
    """The ground as all pictures see it.

    Args:
        pictures: (3, H, W) sRGB each, of any size.
        eyes: their cameras; the object lies about the origin, Z is up.
        probabilities: (h, w) each, that a pixel of the picture is the object.
        height: of the ground (Z).
    """
    axis = REACH * ((torch.arange(_CELLS) + 0.5) / _CELLS * 2.0 - 1.0)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    points = torch.stack([x, y, torch.full_like(x, height)], dim=-1)
    seen, masked = [], []
    for picture, eye, probability in zip(pictures, eyes, probabilities, strict=True):
        place, inside = eye.places(points)
        color = grid_sample(picture[None], place[None], padding_mode="border", align_corners=False)[0]
        covered = grid_sample(probability[None, None], place[None], padding_mode="border", align_corners=False)[0]
        seen.append(torch.where(inside, color, torch.nan))
        masked.append(torch.where(inside, covered, torch.nan))
    colors, hidden = torch.stack(seen), torch.stack(masked)  # (V, 3, N, N), (V, 1, N, N)
    count = (~hidden.isnan()).sum(dim=0)
    free = (hidden < 0.5) | (((hidden < 0.5).sum(dim=0) < _UNMASKED) & ~hidden.isnan())
    told = torch.where(free, colors, torch.nan)
    gains = torch.ones(len(pictures), 3)
    median = told.nanmedian(dim=0).values
    for _ in range(_ROUNDS):
        bright = (median > _DARKEST) & (told > _DARKEST)
        ratio = torch.where(bright, median / told, torch.nan).flatten(2).nanmedian(dim=2).values
        gains = torch.where(ratio.isnan(), 1.0, ratio).clamp(0.3, 3.0)
        median = (told * gains[:, :, None, None]).nanmedian(dim=0).values
    off = (told * gains[:, :, None, None] - median).abs().mean(dim=1, keepdim=True)
    spread = off.nanmedian(dim=0).values
    known = (count >= 2) & ~median.isnan().any(dim=0, keepdim=True)
    return GroundColors(
        torch.where(known, median, 0.0),
        torch.where(known, spread, 0.0),
        torch.where(known, hidden.nanmean(dim=0), 0.0),
        known.float(),
        gains,
        height,
    )


def unlike_ground(ground: GroundColors, picture: Tensor, view: int, eye: Eye, places: Tensor) -> Tensor:
    """How far the pixels of a picture are from what the ground would look like there.

    Args:
        picture: (3, H, W) sRGB, what is at `places`.
        view: which picture it is part of.
        places: (H, W, 2) in that picture, as `Eye.places` gives them.
    Returns:
        (4, H, W): the difference, the ground's own spread, how likely the object covers it, and 1 where the ray meets a
        part of the ground that is known, else 0; all 0 there.
    """
    ray, center = eye.rays(places), eye.center.to(places)
    down = (ground.height - center[2]) / torch.where(ray[..., 2].abs() < 1e-4, -1e-4, ray[..., 2])
    layers = ground.at(center + down[..., None] * ray)
    known = layers[5:] * (down > 0.0)
    off = picture * ground.gains[view][:, None, None] - layers[:3]
    # A pixel off is not another colour: the mean over the pixels around it.
    off = avg_pool2d(off[None], 3, 1, 1, count_include_pad=False)[0].abs().mean(dim=0, keepdim=True)
    return torch.cat([off, layers[3:4], layers[4:5], torch.ones_like(known)]) * (known > 0.5)
