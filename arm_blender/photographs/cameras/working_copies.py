"""Small upright copies of photographs for the solver, the object's mask of each, and where features are looked for."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from ...errors import InputImageError
from ...graphics.color import linear_from_srgb
from ...progress import Progress
from ...views.foreground import foreground
from ...views.image_io import read_orientation
from ...views.mask_files import MASK_FILE, mask_beside, with_mask
from ...views.pillow_io import reduced
from ..masks.joint_look import is_guessed
from ..pictures import Photograph, looked_at

SIDE = 1280
"""Pixels of the longer side: features of larger pictures take longer and place cameras no better than a mask needs."""

SMALLEST = 160
"""Pixels of the longer side below which a picture has no features."""

_AROUND = 0.35
"""Of the object's size, how far the ground around its foot is looked at: beyond, grounds repeat, and backgrounds have
no parallax."""

_FOOT = 0.4
"""Of the object's height, from the top, where the foot begins."""


@dataclass(frozen=True)
class WorkingCopy:
    """What the solver works on.

    Attributes:
        name: of the copy's file.
        photograph: it is of.
        width: pixels of the copy.
        height: as `width`.
        mask: (height, width) float, the object's alpha; None where none was found.
        told: by which way it was found, and what is doubtful about it, as `views.foreground.Heard` is told.
    """

    name: str
    photograph: Photograph
    width: int
    height: int
    mask: Tensor | None
    told: tuple[str, ...] = ()

    @property
    def is_guessed(self) -> bool:
        """Whether nobody gave its mask: it was found in the picture, or is missing."""
        return not self.told or is_guessed(self.told[0])


def working_copies(
    paths: list[Path], folder: Path, colors: Path, progress: Progress
) -> tuple[list[WorkingCopy], dict[str, str]]:
    """Writes the copies of photographs, as grey levels.

    Args:
        paths: of the photographs; a mask that lies beside one goes before every way to find it.
        folder: of the copies; exists.
        colors: folder for copies with their colours, under the same names; exists.
        progress: told each picture.
    Returns:
        The copies, and of each picture that does not do its name and the reason.
    """
    copies: list[WorkingCopy] = []
    left_out: dict[str, str] = {}
    for index, path in enumerate(paths):
        progress(index / len(paths), f"reading {path.name}")
        try:
            photograph = looked_at(path)
            pixels = reduced(path, SIDE)
        except InputImageError as error:
            left_out[path.name] = str(error).removeprefix(f"{path}: ")
            continue
        height, width = pixels.shape[:2]
        if max(width, height) < SMALLEST:
            left_out[path.name] = f"{width}x{height} pixels; give at least {SMALLEST}"
            continue
        name = f"{index:04d}.png"
        picture = Image.fromarray(pixels[..., :3])
        picture.convert("L").save(folder / name, compress_level=1)
        picture.save(colors / name, compress_level=1)
        told: list[str] = []
        try:
            mask = _mask(pixels, path, told)
        except InputImageError as error:
            left_out[path.name] = str(error)
            continue
        copies.append(WorkingCopy(name, photograph, width, height, mask, tuple(told)))
    return copies, left_out


def lenses_of(copies: list[WorkingCopy]) -> list[dict[str, Any]]:
    """The copies by the lens that took them, as the solver's process wants it: of one size, one focal length."""
    lenses: dict[tuple[int, int, float | None], list[str]] = {}
    for copy in copies:
        focal = copy.photograph.focal
        scaled = None if focal is None else round(focal * copy.width / copy.photograph.width, 1)
        lenses.setdefault((copy.width, copy.height, scaled), []).append(copy.name)
    return [
        {"width": width, "height": height, "focal": focal, "pictures": names}
        for (width, height, focal), names in lenses.items()
    ]


def write_regions(copies: list[WorkingCopy], folder: Path, ground: bool) -> Path:
    """Writes where features are looked for, as COLMAP wants it: NAME.png of the copy NAME.

    Args:
        ground: also on the ground around the object's foot; else on the object alone.
    """
    folder.mkdir()
    for copy in copies:
        region = np.full((copy.height, copy.width), 255, np.uint8)
        if copy.mask is not None:
            region = _region((copy.mask > 0.3).numpy(), ground)
        Image.fromarray(region).save(folder / f"{copy.name}.png", compress_level=1)
    return folder


def _region(mask: NDArray[np.bool_], ground: bool) -> NDArray[np.uint8]:
    """(H, W) 255 where features are looked for."""
    region = np.where(mask, 255, 0).astype(np.uint8)
    rows, columns = np.nonzero(mask)
    if ground and len(rows):
        height, width = int(np.ptp(rows)), int(np.ptp(columns))
        around = round(_AROUND * max(height, width))
        top, bottom = rows.min() + round(_FOOT * height), rows.max() + around
        region[top:bottom, max(0, columns.min() - around) : columns.max() + around] = 255
    return region


def _mask(pixels: NDArray[np.uint8], path: Path, told: list[str]) -> Tensor | None:
    """The object's alpha of (H, W, 4) sRGB pixels; None where no way is sure of it.

    Raises:
        InputImageError: a mask beside the picture does not fit it.
    """
    values = torch.from_numpy(pixels).permute(2, 0, 1) / 255.0
    image = torch.cat([linear_from_srgb(values[:3]), values[3:]])
    given = mask_beside(path, path.parent)
    if given is not None:
        told.append(MASK_FILE)
        mask = with_mask(image, given, read_orientation(path)[2])[3]
    else:
        try:
            mask = foreground(image, path, lambda _, way: told.append(way))[3]
        except InputImageError:
            return None
    return mask if bool((mask > 0.5).any()) else None
