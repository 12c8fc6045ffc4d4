"""What Pillow reads for us: HEIC, which OpenImageIO's wheels do not know, colour profiles, small copies in no time."""

import io
import logging
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms, ImageOps

from ..errors import InputImageError
from ..machine.libraries import is_there
from ..machine.picture_files import HEIF_SUFFIXES

logger = logging.getLogger(__name__)

_EXIF_ORIENTATION = 274

_SAME = 2
"""Levels of 255 by which a profile may move colours and is still taken for sRGB."""


def open_picture(path: Path) -> Image.Image:
    """A picture by Pillow, not yet decoded.

    Raises:
        InputImageError: missing, no picture, or HEIC where pillow-heif is not installed.
    """
    if path.suffix.lower() in HEIF_SUFFIXES:
        if not is_there("pillow_heif"):
            raise InputImageError(f"{path}: HEIC needs pillow-heif: pip install pillow-heif, or export it as JPEG")
        import pillow_heif

        pillow_heif.register_heif_opener()
    try:
        return Image.open(path)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        logger.debug("%s: %s", path, error)
        raise InputImageError(f"{path}: not a readable picture; give a JPEG, PNG, WebP, TIFF or HEIC file") from error


def is_pillows(path: Path) -> bool:
    """Whether OpenImageIO does not read a picture as it is: HEIC, and WebP that moves, whose alpha it loses."""
    if path.suffix.lower() in HEIF_SUFFIXES:
        return True
    with path.open("rb") as file:
        start = file.read(21)
    # In the extended form of WebP the second bit of its flags stands for an animation.
    return start[:4] == b"RIFF" and start[8:16] == b"WEBPVP8X" and bool(start[20:21] and start[20] & 2)


def exif_orientation(picture: Image.Image) -> int:
    """The EXIF orientation of an open picture, 1 to 8; 1, as it is stored, where none can be read."""
    try:
        found = picture.getexif().get(_EXIF_ORIENTATION, 1)
    except (OSError, ValueError, TypeError, SyntaxError, EOFError, struct.error) as error:
        logger.debug("EXIF: %s", error)
        return 1
    return int(found) if found in range(1, 9) else 1


def decoded(picture: Image.Image, path: Path) -> NDArray[np.uint8]:
    """(H, W, 4) sRGB with straight alpha of an open picture, turned upright.

    Raises:
        InputImageError: truncated or damaged.
    """
    try:
        profile = picture.info.get("icc_profile")
        upright = ImageOps.exif_transpose(picture)
        pixels = np.asarray(upright.convert("RGBA")).copy()
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        logger.debug("%s: %s", path, error)
        raise InputImageError(f"{path}: the picture is truncated or damaged; export it again") from error
    transform = srgb_from_profile(profile) if picture.mode in ("RGB", "RGBA") else None
    if transform is not None:
        pixels[..., :3] = transformed(pixels[..., :3], transform)
    return pixels


def reduced(path: Path, side: int) -> NDArray[np.uint8]:
    """A small copy of a picture; a JPEG is decoded at a fraction of its size, which takes a tenth of the time.

    Args:
        path: of an 8-bit picture; deeper ones are rounded.
        side: pixels of the longer side, at most.
    Returns:
        (H, W, 4) sRGB with straight alpha, upright.
    Raises:
        InputImageError: as `open_picture` and `decoded`.
    """
    with open_picture(path) as picture:
        picture.draft("RGB", (side, side))
        # The profile and the orientation belong to the picture, not to its pixels.
        pixels = decoded(picture, path)
    image = Image.fromarray(pixels)
    image.thumbnail((side, side), Image.Resampling.BOX, reducing_gap=None)
    return np.array(image)  # A copy may be written to, as torch wants it.


def srgb_from_profile(profile: bytes | None) -> ImageCms.ImageCmsTransform | None:
    """What brings RGB of an embedded ICC profile to sRGB; None where there is none, it is sRGB itself, or damaged."""
    if not profile:
        return None
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if source.profile.xcolor_space.strip() != "RGB":
            return None
        transform = ImageCms.buildTransform(source, ImageCms.createProfile("sRGB"), "RGB", "RGB")
    except (OSError, ImageCms.PyCMSError) as error:
        logger.debug("colour profile: %s", error)
        return None
    levels = np.linspace(0, 255, 5).astype(np.uint8)
    colors = np.stack(np.meshgrid(levels, levels, levels), axis=-1).reshape(5, 25, 3)
    moved = np.abs(transformed(colors, transform).astype(int) - colors).max()
    return transform if moved > _SAME else None


def transformed(pixels: NDArray[np.uint8], transform: ImageCms.ImageCmsTransform) -> NDArray[np.uint8]:
    """(H, W, 3) colours in the other space."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    result = ImageCms.applyTransform(image, transform)
    assert result is not None  # It is None only in place.
    return np.asarray(result)
