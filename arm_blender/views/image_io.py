"""Pictures in and out of files, through OpenImageIO: linear Rec.709 with straight alpha inside, sRGB in 8-bit files."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..errors import InputImageError
from ..graphics.color import bytes_from_unit, linear_from_srgb, srgb_from_linear
from ..machine.files import whole_file
from ..machine.picture_files import HEIF_SUFFIXES
from ..machine.quiet import STDERR, silenced
from .pillow_io import decoded, exif_orientation, is_pillows, open_picture, srgb_from_profile, transformed

logger = logging.getLogger(__name__)

MAXIMUM_SIDE = 8192
"""Pixels a side; larger pictures are refused before they are decoded."""

_MOST_CHANNELS = 64
"""Of a file, in all of its layers: of each pixel all are decoded."""

BAND = 64
"""Rows that are decoded at once, and a little more where tiles are higher."""


def read_image(path: Path) -> Tensor:
    """A picture as the program holds it.

    Args:
        path: 8 or 16-bit PNG, JPEG, WebP, TIFF, HEIC (sRGB, or as an embedded ICC profile says), EXR or HDR (linear);
            grey, grey with alpha, RGB or RGBA. Under a profile other than sRGB 16 bits are rounded to 8.
    Returns:
        (4, H, W) float32 in [0, 1], linear Rec.709 and straight alpha; alpha is 1 where the file has none. Turned
        upright as its EXIF orientation says.
    Raises:
        InputImageError: missing, not a picture, truncated, or larger than `MAXIMUM_SIDE`.
    """
    _check_file(path)
    if is_pillows(path):
        return _by_pillow(path)
    with _quiet_decoders():
        source = _opened(path)
        try:
            spec = source.spec()
            _check_claims(spec, path)
            image = np.empty((4, spec.height, spec.width), np.float32)
            # Band by band: the steps from a file's numbers to ours would take several times the picture's memory.
            profile = srgb_from_profile(_profile(spec))
            step = -(-BAND // max(1, spec.tile_height)) * max(1, spec.tile_height)
            for top in range(0, spec.height, step):
                bottom = min(top + step, spec.height)
                pixels = _rows(source, spec, top, bottom)
                # A truncated JPEG comes back with grey rows and an error, every other format without pixels.
                if pixels is None or source.has_error:
                    logger.debug("%s: %s", path, source.geterror())
                    raise InputImageError(f"{path}: the picture is truncated or damaged; export it again")
                for first in range(0, bottom - top, BAND):
                    part = _shares(pixels[first : first + BAND])
                    if profile is not None:
                        part[..., :3] = transformed(np.round(part[..., :3] * 255.0).astype(np.uint8), profile) / 255.0
                    rows = slice(top + first, top + first + len(part))
                    image[:, rows] = _linear(part, spec, _is_premultiplied(source, spec)).numpy()
        finally:
            source.close()
        orientation = _orientation(source, spec, path)
    upright = _upright(image.transpose(1, 2, 0), orientation)
    return torch.from_numpy(np.ascontiguousarray(upright.transpose(2, 0, 1)))


def read_orientation(path: Path) -> tuple[int, int, int]:
    """Width and height of a picture as its file stores it, and its EXIF orientation, 1 to 8.

    Raises:
        InputImageError: missing, or not a picture.
    """
    _check_file(path)
    if is_pillows(path):
        with open_picture(path) as picture:
            width, height = picture.size
            turned = path.suffix.lower() not in HEIF_SUFFIXES and exif_orientation(picture) >= 5
            return (height, width, 1) if turned else (width, height, 1)  # Its reader turns it.
    with _quiet_decoders():
        source = _opened(path)
        try:
            spec = source.spec()
            return spec.width, spec.height, _orientation(source, spec, path)
        finally:
            source.close()


def write_png(path: Path, image: Tensor, srgb: bool) -> None:
    """An 8-bit PNG, whole or not at all.

    Args:
        path: of the file; its folder exists.
        image: (C, H, W) in [0, 1], C = 1 grey, 3 RGB or 4 RGB with straight alpha; clamped, and rounded to 8 bits.
        srgb: colour, encoded from linear Rec.709 to sRGB; otherwise data, stored as it is. Alpha is data always.
    Raises:
        ValueError: not (1|3|4, H, W).
        OutputError: the file cannot be written.
    """
    if image.ndim != 3 or image.shape[0] not in (1, 3, 4):
        raise ValueError(f"image must be (1|3|4, H, W), got {tuple(image.shape)}")
    image = image.detach().to("cpu", torch.float32)
    if srgb:
        image = torch.cat([srgb_from_linear(image[:3]), image[3:]])
    pixels = bytes_from_unit(image).permute(1, 2, 0).contiguous().numpy()
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, "uint8")
    spec.attribute("oiio:UnassociatedAlpha", 1)
    if srgb:
        spec.attribute("oiio:ColorSpace", "sRGB")
    with whole_file(path) as temporary:
        sink = oiio.ImageOutput.create(str(temporary))
        written = sink.open(str(temporary), spec) and sink.write_image(pixels)
        if not (sink.close() and written):
            raise OSError(0, sink.geterror() or "no space")


def _opened(path: Path) -> oiio.ImageInput:
    """A picture's file, open.

    Raises:
        InputImageError: missing, empty, or not a picture.
    """
    # "Unassociated" hands over the stored colour: OpenImageIO would multiply by alpha in 8 bits and lose the dark ends.
    wish = oiio.ImageSpec()
    wish.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), wish)
    if source is None:
        reason = oiio.geterror()
        logger.debug("%s: %s", path, reason)
        raise InputImageError(f"{path}: not a readable picture; give a PNG, JPEG, WebP, TIFF, EXR or HDR file")
    try:
        source.spec().channelnames  # noqa: B018
    except UnicodeDecodeError as error:
        raise InputImageError(f"{path}: the name of a channel is no text; export it again") from error
    if min(source.spec().width, source.spec().height) < 1:  # The numbers of a Radiance file have a sign.
        raise InputImageError(f"{path}: a picture without pixels; export it again")
    return source


def _check_file(path: Path) -> None:
    """Raises `InputImageError` where a picture's file is missing or empty, or has a name that no library takes."""
    if not path.is_file():
        raise InputImageError(f"{path}: no such file; check the path")
    if path.stat().st_size == 0:
        raise InputImageError(f"{path}: the file is empty; export the picture again")
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise InputImageError(f"{path}: the name is no UTF-8; rename the file or its folder") from error


def _orientation(source: oiio.ImageInput, spec: oiio.ImageSpec, path: Path) -> int:
    """The EXIF orientation, 1 to 8, of an open picture; OpenImageIO reads none from WebP."""
    if source.format_name() != "webp":
        found = spec.get_int_attribute("Orientation", 1)
    else:
        with open_picture(path) as picture:
            found = exif_orientation(picture)
    return found if found in range(1, 9) else 1


def _is_premultiplied(source: oiio.ImageInput, spec: oiio.ImageSpec) -> bool:
    """Whether colours come multiplied by alpha: those of EXR, and of TIFF that does not say otherwise."""
    if source.format_name() == "tiff":
        return spec.alpha_channel >= 0 and spec.get_int_attribute("oiio:UnassociatedAlpha", 0) == 0
    return source.format_name() == "openexr"


def _by_pillow(path: Path) -> Tensor:
    """`read_image` of a file that `is_pillows`; of one that moves, the first picture."""
    with open_picture(path) as picture:
        if max(picture.size) > MAXIMUM_SIDE:
            size = "x".join(map(str, picture.size))
            raise InputImageError(f"{path}: {size} pixels; scale it to at most {MAXIMUM_SIDE} a side")
        pixels = torch.from_numpy(decoded(picture, path)).permute(2, 0, 1) / 255.0
    return torch.cat([linear_from_srgb(pixels[:3]), pixels[3:]])


def _profile(spec: oiio.ImageSpec) -> bytes | None:
    """The ICC profile of a file with colours in integers; others are linear already."""
    profile = spec.getattribute("ICCProfile")
    integers = spec.format.basetype in (oiio.BASETYPE.UINT8, oiio.BASETYPE.UINT16)
    if profile is None or not integers or tuple(name.upper() for name in spec.channelnames[:3]) != ("R", "G", "B"):
        return None
    return np.asarray(profile, np.uint8).tobytes()


def _check_claims(spec: oiio.ImageSpec, path: Path) -> None:
    """Raises `InputImageError` where a picture is larger than we take, or none of one plane."""
    if max(spec.width, spec.height) > MAXIMUM_SIDE:
        size = f"{spec.width}x{spec.height}"
        raise InputImageError(f"{path}: {size} pixels; scale it to at most {MAXIMUM_SIDE} a side")
    if spec.nchannels > _MOST_CHANNELS or spec.depth > 1 or spec.deep:
        what = f"{spec.nchannels} channels, depth {spec.depth}{', deep' if spec.deep else ''}"
        raise InputImageError(f"{path}: {what}; export a flat picture of red, green, blue and alpha")
    if max(spec.tile_width, spec.tile_height) > MAXIMUM_SIDE:
        size = f"{spec.tile_width}x{spec.tile_height}"
        raise InputImageError(f"{path}: tiles of {size} pixels; save it without tiles")


def _shares(pixels: NDArray[Any]) -> NDArray[np.float32]:
    """Numbers of a file as float32; those of integers as shares of the largest."""
    if pixels.dtype.kind == "f":
        return pixels.astype(np.float32)
    return pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)


def _rows(source: oiio.ImageInput, spec: oiio.ImageSpec, top: int, bottom: int) -> NDArray[Any] | None:
    """(bottom - top, W, N) of the file, whole tiles or the last ones; None where they cannot be read.

    Bytes as bytes: a row of tiles as high as the picture would be four times as large in float32.
    """
    x, y = spec.x, spec.y  # An EXR's window may begin anywhere.
    kind = "uint8" if spec.format.basetype == oiio.BASETYPE.UINT8 else "float"
    if spec.tile_width:
        return source.read_tiles(
            0, 0, x, x + spec.width, y + top, y + bottom, spec.z, spec.z + 1, 0, spec.nchannels, kind
        )
    return source.read_scanlines(0, 0, y + top, y + bottom, spec.z, 0, spec.nchannels, kind)


def _linear(pixels: NDArray[np.float32], spec: oiio.ImageSpec, premultiplied: bool) -> Tensor:
    """(4, H, W) linear Rec.709 and straight alpha of a file's rows (H, W, N).

    Args:
        premultiplied: the colours, as they are stored.
    """
    image = torch.from_numpy(np.ascontiguousarray(_rgba_of_channels(pixels, spec.channelnames).transpose(2, 0, 1)))
    alpha = image[3:].clamp(0.0, 1.0)
    if spec.format.basetype in (oiio.BASETYPE.HALF, oiio.BASETYPE.FLOAT, oiio.BASETYPE.DOUBLE):
        color = _straight(image[:3], alpha) if premultiplied else image[:3]
    else:
        color = linear_from_srgb(_straight(image[:3], alpha).clamp(max=1.0) if premultiplied else image[:3])
    return torch.cat([color.clamp(0.0, 1.0), alpha])


def _rgba_of_channels(pixels: NDArray[np.float32], names: tuple[str, ...]) -> NDArray[np.float32]:
    """(H, W, 4) of (H, W, N) by the channels' names; alpha is 1 where there is none.

    A multilayer EXR puts its layer's name before each channel: the first layer that has R, G and B is taken.
    """
    short = [name.rpartition(".")[2].upper() for name in names]
    alpha = pixels[..., short.index("A")] if "A" in short else np.ones(pixels.shape[:2], np.float32)
    if {"R", "G", "B"} <= set(short):
        color = [pixels[..., short.index(name)] for name in "RGB"]
    else:
        color = [pixels[..., 0]] * 3
    return np.nan_to_num(np.stack([*color, alpha], axis=-1), nan=0.0, posinf=1.0, neginf=0.0)


def _upright(pixels: NDArray[np.float32], orientation: int) -> NDArray[np.float32]:
    """(H, W, C) as it is meant to be seen, from the EXIF orientation (1 to 8) of the stored rows."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.transpose(1, 0, 2)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def as_stored(image: Tensor, orientation: int) -> Tensor:
    """An upright picture (C, H, W) as the rows of its file have it, whose EXIF orientation is 1 to 8."""
    undone = {6: 8, 8: 6}.get(orientation, orientation)  # All others undo themselves.
    pixels = _upright(image.permute(1, 2, 0).numpy(), undone)
    return torch.from_numpy(np.ascontiguousarray(pixels.transpose(2, 0, 1)))


def _straight(color: Tensor, alpha: Tensor) -> Tensor:
    """(3, H, W) straight colour of premultiplied `color`; 0 where `alpha` (1, H, W) is 0."""
    return torch.where(alpha > 0.0, color / alpha.clamp(min=1e-6), torch.zeros_like(color))


@contextmanager
def _quiet_decoders() -> Iterator[None]:
    """Keeps what libpng and OpenEXR print by themselves off the terminal: the error that we raise says it.

    Only on the main thread: elsewhere somebody else may be writing to the same descriptor.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with silenced(STDERR):
        yield
