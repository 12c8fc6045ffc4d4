"""Renders put beside and below one another on an even backdrop."""

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

BACKDROP = 0.82
"""sRGB grey behind the object."""


def write_sheet(path: Path, columns: Sequence[Sequence[Path]]) -> None:
    """One opaque PNG of pictures of one size.

    Args:
        path: of the sheet.
        columns: from left to right; the pictures of each from top to bottom.
    Raises:
        OSError, RuntimeError: a picture cannot be read, or the sheet not be written.
    """
    stacked = [np.concatenate([_read_pixels(picture) for picture in reversed(column)]) for column in columns]
    sheet = np.concatenate(stacked, axis=1)
    sheet[..., :3] = sheet[..., :3] * sheet[..., 3:] + BACKDROP * (1.0 - sheet[..., 3:])
    sheet[..., 3] = 1.0
    _write_pixels(path, sheet)


def _read_pixels(path: Path) -> NDArray[np.float32]:
    """(H, W, 4) float32 of a picture as it is stored, bottom row first."""
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        pixels = np.empty(len(image.pixels), dtype=np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(image.size[1], image.size[0], 4)
    finally:
        bpy.data.images.remove(image)


def _write_pixels(path: Path, pixels: NDArray[np.float32]) -> None:
    """Write (H, W, 4) in [0, 1], bottom row first, as an 8-bit PNG."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("sheet", width, height, alpha=True)
    try:
        image.pixels.foreach_set(np.ascontiguousarray(pixels, dtype=np.float32).ravel())
        image.filepath_raw = str(path)
        image.file_format = "PNG"
        image.save()
    finally:
        bpy.data.images.remove(image)
