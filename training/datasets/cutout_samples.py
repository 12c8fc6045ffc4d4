"""Photographs with masks for the cut-out network: rendered scenes, and cut-outs of them laid over other surroundings.

Read are the files of `python -m training render --layout scenes` (see rendering/captures/scenes_blender.py).
"""

import io
import math
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn.functional import affine_grid, conv2d, grid_sample, pad

from arm_blender.errors import ArmError
from arm_blender.graphics.color import bytes_from_unit

from ..random_numbers import uniform

COMPOSITES = 0.45
"""Share of the samples that are cut-outs over other surroundings; no light or shadow joins them, but there are many."""

HELD_OUT_EVERY = 16
"""One object in so many only validates."""

EMPTY = 0.03
"""Share of the samples that show no object."""


@dataclass(frozen=True)
class Scenes:
    """Of one object.

    Attributes:
        name: the object's key.
        rgb: (N, 3, S, S) uint8 sRGB; the last without the object.
        mask: (N, 1, S, S) uint8, how much of a pixel is the object.
    """

    name: str
    rgb: Tensor
    mask: Tensor

    @property
    def held_out(self) -> bool:
        """Whether the object only validates."""
        return zlib.crc32(self.name.encode()) % HELD_OUT_EVERY == 0


def read_scenes(folder: Path) -> list[Scenes]:
    """Every object of a folder that is seen in its pictures.

    Raises:
        ArmError: a file cannot be read, or there is none.
    """
    found = []
    for path in sorted(folder.glob("*.npz")):
        try:
            with np.load(path) as file:
                rgb, mask = torch.from_numpy(file["rgb"]), torch.from_numpy(file["mask"])
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise ArmError(f"{path}: not readable ({error}); remove it, and render again") from error
        seen = (mask > 127).flatten(1).float().mean(dim=1) > 0.002
        seen[-1] = True  # The empty place.
        if int(seen.sum()) > 1:
            found.append(Scenes(path.stem, rgb[seen].permute(0, 3, 1, 2).contiguous(), mask[seen][:, None]))
    if not found:
        raise ArmError(f"{folder}: no scenes; make them with `python -m training render --layout scenes`")
    return found


def drawn(
    scenes: Sequence[Scenes], size: int, count: int, random: torch.Generator, places: Sequence[Tensor] = ()
) -> tuple[Tensor, Tensor]:
    """Random samples, seen by a random camera: (count, 3, size, size) sRGB and (count, 1, size, size) alpha.

    Args:
        places: (3, S, S) uint8 sRGB each, of `places.py`; cut-outs are laid over these as well as over empty scenes.
    """
    pairs = [_sample(scenes, places, size, random) for _ in range(count)]
    return torch.stack([rgb for rgb, _ in pairs]), torch.stack([alpha for _, alpha in pairs])


def plain(scenes: Sequence[Scenes], size: int) -> tuple[Tensor, Tensor]:
    """Every picture that shows an object, unchanged but for its size."""
    rgb, mask = [], []
    for item in scenes:
        for k in range(len(item.rgb) - 1):
            both = torch.cat([item.rgb[k], item.mask[k]]).float()[None] / 255.0
            both = torch.nn.functional.interpolate(both, (size, size), mode="bilinear", antialias=True)[0]
            rgb.append(both[:3])
            mask.append(both[3:])
    return torch.stack(rgb), torch.stack(mask)


def _sample(
    scenes: Sequence[Scenes], places: Sequence[Tensor], size: int, random: torch.Generator
) -> tuple[Tensor, Tensor]:
    item, kind = scenes[_index(len(scenes), random)], uniform(random)
    if kind < EMPTY:
        picture = _unit(item, len(item.rgb) - 1)
        both = _window(picture, size, random)
    elif kind < EMPTY + COMPOSITES:
        other = scenes[_index(len(scenes), random)]
        place = _unit(other, len(other.rgb) - 1)
        if len(places) and uniform(random) < 0.5:
            color = places[_index(len(places), random)].float() / 255.0
            place = torch.cat([color, torch.zeros_like(color[:1])])
        both = _composite(item, place, size, random)
    else:
        both = _window(_unit(item, _index(len(item.rgb) - 1, random)), size, random)
    if uniform(random) < 0.5:
        both = both.flip(-1)
    return developed(both[:3], random), both[3:]


def _unit(item: Scenes, k: int) -> Tensor:
    """(4, S, S) in [0, 1]: colour and alpha."""
    return torch.cat([item.rgb[k], item.mask[k]]).float() / 255.0


def _index(count: int, random: torch.Generator) -> int:
    return int(torch.randint(count, (), generator=random))


def _window(picture: Tensor, size: int, random: torch.Generator) -> Tensor:
    """A random part of a picture (4, S, S) as (4, size, size): now all of it, now the object alone, cut or not."""
    draw = partial(uniform, random)
    rows, columns = (torch.nonzero((picture[3] > 0.5).any(dim=dim))[:, 0] for dim in (1, 0))
    side = picture.shape[-1]
    width, height = (draw(0.55, 1.0) for _ in range(2))
    if draw() < 0.3:
        width = height = 1.0
    x, y = draw(width - 1.0, 1.0 - width), draw(height - 1.0, 1.0 - height)
    if len(rows) and draw() < 0.6:
        # Around the object, as a second look takes it; sometimes off by so much that the border cuts it.
        box = [(float(v.min()), float(v.max()) + 1.0) for v in (columns, rows)]
        (x, width), (y, height) = (_around(low, high, side, draw(0.55, 1.0), draw(-0.25, 0.25)) for low, high in box)
    angle = math.radians(draw(-12.0, 12.0)) if draw() < 0.4 else 0.0
    c, s = math.cos(angle), math.sin(angle)
    theta = torch.tensor([[[c * width, -s * height, x], [s * width, c * height, y]]])
    grid = affine_grid(theta, [1, 4, size, size], align_corners=False)
    return grid_sample(picture[None], grid, mode="bicubic", padding_mode="reflection", align_corners=False)[0].clamp(
        0.0, 1.0
    )


def _around(low: float, high: float, side: int, fill: float, away: float) -> tuple[float, float]:
    """Middle and half of a window in [-1, 1] in which low to high (pixels) takes the share `fill`, if it fits."""
    half = min(max((high - low) / fill, 0.25 * side), side) / side
    middle = (low + high) / side - 1.0 + 2.0 * away * half
    return min(max(middle, half - 1.0), 1.0 - half), half


def _composite(item: Scenes, place: Tensor, size: int, random: torch.Generator) -> Tensor:
    """An object (4, size, size) at any size and place, now and then cut by the border, over an empty one (4, S, S)."""
    draw = partial(uniform, random)
    ground = _window(place, size, random)[:3]
    if draw() < 0.15:
        ground = torch.rand((3, 1, 1), generator=random) + 0.05 * (ground - ground.mean())
    picture = _unit(item, _index(len(item.rgb) - 1, random))
    rows, columns = (torch.nonzero((picture[3] > 0.5).any(dim=dim))[:, 0] for dim in (1, 0))
    side = picture.shape[-1]
    center = [(float(v.min()) + float(v.max()) + 1.0) / side - 1.0 for v in (columns, rows)]
    extent = max(float(v.max() - v.min()) + 1.0 for v in (columns, rows)) / side
    fill = draw(0.15, 0.95) if draw() < 0.8 else draw(0.9, 1.3)
    scale, stretch = extent / fill, draw(0.8, 1.25)
    angle = math.radians(draw(-20.0, 20.0))
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    loose = max(0.15, 1.0 - fill)
    away = [draw(-loose, loose), draw(-loose, loose)]
    x = center[0] - c * stretch * away[0] + s * away[1]
    y = center[1] - s * stretch * away[0] - c * away[1]
    grid = affine_grid(torch.tensor([[[c * stretch, -s, x], [s * stretch, c, y]]]), [1, 4, size, size], False)
    # The rim of a cut-out has the colour of where it was.
    cut = grid_sample(picture[None], grid, mode="bilinear", padding_mode="zeros", align_corners=False)[0]
    alpha = cut[3:]
    if draw() < 0.3:
        soft = _blurred(alpha, draw(1.5, 6.0)).roll((_index(5, random), _index(9, random) - 4), dims=(1, 2))
        ground = ground * (1.0 - draw(0.2, 0.7) * soft)
    elif draw() < 0.7 and bool((alpha > 0.5).any()):
        ground = ground * (1.0 - draw(0.3, 0.8) * _cast_shadow(alpha, random))
    color = cut[:3] * draw(0.7, 1.3)
    return torch.cat([color * alpha + ground * (1.0 - alpha), alpha]).clamp(0.0, 1.0)


def _cast_shadow(alpha: Tensor, random: torch.Generator) -> Tensor:
    """The shadow (1, S, S) of an alpha (1, S, S) on a ground that begins at its feet, towards us or away."""
    draw = partial(uniform, random)
    side = alpha.shape[-1]
    feet = 2.0 * (float(torch.nonzero((alpha[0] > 0.5).any(dim=1))[-1]) + 1.0) / side - 1.0
    along = draw(0.15, 0.9) * (1.0 if draw() < 0.5 else -1.0)
    sideways = draw(-1.5, 1.5)
    # What is h above the feet falls h * along below them, and h * sideways to the right.
    theta = torch.tensor(
        [[[1.0, -sideways / along, feet * sideways / along], [0.0, -1.0 / along, feet + feet / along]]]
    )
    grid = affine_grid(theta, [1, 1, side, side], align_corners=False)
    return _blurred(grid_sample(alpha[None], grid, padding_mode="zeros", align_corners=False)[0], draw(0.4, 2.0))


def developed(srgb: Tensor, random: torch.Generator) -> Tensor:
    """A picture (3, S, S) as another camera would have kept it: exposure, balance, contrast, blur, noise, JPEG."""
    draw = partial(uniform, random)
    linear = srgb.clamp(0.0, 1.0) ** 2.2
    balance = torch.tensor([math.exp(draw(-0.25, 0.25)) for _ in range(3)])[:, None, None]
    image = (linear * balance * math.exp(draw(-0.8, 0.6))).clamp(0.0, 1.0) ** (1.0 / (2.2 * draw(0.8, 1.25)))
    grey = image.mean(dim=0, keepdim=True)
    image = grey + (image - grey) * (draw(0.3, 1.5) if draw() < 0.9 else 0.0)
    if draw() < 0.35:
        image = _blurred(image, draw(0.4, 1.4))
    if draw() < 0.5:
        image = image + draw(0.0, 0.05) * torch.randn(image.shape, generator=random)
    if draw() < 0.5:
        image = _as_jpeg(image, int(draw(30.0, 95.0)))
    return image.clamp(0.0, 1.0)


def _blurred(image: Tensor, sigma: float) -> Tensor:
    radius = max(1, math.ceil(2.5 * sigma))
    taps = torch.exp(-0.5 * (torch.arange(-radius, radius + 1) / sigma) ** 2)
    taps = (taps / taps.sum())[None, None, None]
    planes = pad(image[:, None], (radius,) * 4, mode="replicate")
    return conv2d(conv2d(planes, taps), taps.transpose(2, 3))[:, 0]


def _as_jpeg(image: Tensor, quality: int) -> Tensor:
    kept = io.BytesIO()
    Image.fromarray(bytes_from_unit(image).permute(1, 2, 0).contiguous().numpy()).save(kept, "JPEG", quality=quality)
    return torch.from_numpy(np.array(Image.open(kept))).permute(2, 0, 1) / 255.0
