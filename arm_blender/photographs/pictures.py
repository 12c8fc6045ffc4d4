"""What a photograph says of itself: its size, its focal length, and how sharp it is."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from ..machine.picture_files import pictures_in
from ..views.mask_files import mask_beside
from ..views.pillow_io import exif_orientation, open_picture

NOT_TAKEN = (".exr", ".hdr")
"""Pictures that no camera takes."""

FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)
"""Millimetres: what an equivalent focal length refers to (CIPA DCG-001)."""

_EXIF = 0x8769
_FOCAL, _FOCAL_35 = 0x920A, 0xA405
_PLANE_X, _PLANE_UNIT, _PIXELS_X = 0xA20E, 0xA210, 0xA002
_MILLIMETRES = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""Of the unit in which a sensor's pixels are counted."""

_FOCALS = 0.3, 10.0
"""Focal lengths as shares of the longer side that a picture of an object may have: 118° to 6° across."""


@dataclass(frozen=True)
class Photograph:
    """A picture before it is decoded.

    Attributes:
        path: of the file.
        width: pixels of the upright picture.
        height: as `width`.
        focal: pixels of the upright picture, as its EXIF says; None where it says nothing.
    """

    path: Path
    width: int
    height: int
    focal: float | None


def photographs_in(folder: Path) -> list[Path]:
    """The pictures of a folder that a camera may have taken, by name; masks that lie beside them are none."""
    found = [path for path in pictures_in(folder) if path.suffix.lower() not in NOT_TAKEN]
    masks = {mask_beside(path, folder) for path in found}
    return [path for path in found if path not in masks]


def looked_at(path: Path) -> Photograph:
    """What the head of a picture's file says.

    Raises:
        InputImageError: it is no picture.
    """
    with open_picture(path) as picture:
        width, height = picture.size
        focal = _focal(picture)
        if exif_orientation(picture) >= 5:
            width, height = height, width
    return Photograph(path, width, height, focal)


def sharpness(grey: NDArray[np.uint8]) -> float:
    """How much detail a picture (H, W) has: the mean square of its Laplacian; blur takes it away."""
    values = grey.astype(np.float32)
    inner = values[1:-1, 1:-1]
    laplacian = values[:-2, 1:-1] + values[2:, 1:-1] + values[1:-1, :-2] + values[1:-1, 2:] - 4.0 * inner
    return float((laplacian**2).mean()) if laplacian.size else 0.0


def _focal(picture: Image.Image) -> float | None:
    """Pixels, from the equivalent focal length, or from the true one and the density of the sensor's pixels."""
    try:
        exif = picture.getexif().get_ifd(_EXIF)
        long, diagonal = max(picture.size), math.hypot(*picture.size)
        found = 0.0
        if equivalent := float(exif.get(_FOCAL_35, 0.0)):
            found = equivalent / FULL_FRAME_DIAGONAL * diagonal
        elif (true := float(exif.get(_FOCAL, 0.0))) and (density := float(exif.get(_PLANE_X, 0.0))):
            # The density is of the picture as it was taken; it may have been scaled since.
            scale = picture.size[0] / (float(exif.get(_PIXELS_X, 0.0)) or picture.size[0])
            found = true / _MILLIMETRES.get(int(exif.get(_PLANE_UNIT, 2)), 25.4) * density * scale
    except (TypeError, ValueError, ZeroDivisionError, OSError, SyntaxError, UnidentifiedImageError):
        return None  # Cameras write all sorts of things.
    return found if math.isfinite(found) and _FOCALS[0] * long <= found <= _FOCALS[1] * long else None
