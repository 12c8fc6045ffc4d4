"""One photograph as a view: without distortion, its object cut out, in a window around it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageOps
from torch import Tensor

from ..errors import InputImageError
from ..graphics.color import srgb_from_linear
from ..progress import Progress
from ..views.foreground import foreground
from ..views.image_io import read_image, read_orientation
from ..views.mask_files import read_mask, with_mask
from ..views.masks import sees_something
from ..views.opacity import solid
from ..views.preprocess import MAXIMUM_SIDE
from .capture import Lens, PosedPhotograph
from .framing import Window, around, is_cut, known_rectangle, whole_window
from .undistort import RayTable, undistorted

_GLANCE = 1024
"""Pixels of the longer side that are enough to see how sharp a photograph is."""

_BOX = 512
"""Pixels of the longer side that are enough to see where a mask lies that is given."""


PAINTED = "painted mask"
"""The way of a mask that the user has painted."""


@dataclass(frozen=True)
class PaintedMask:
    """A mask that the user has painted on an earlier view.

    Attributes:
        path: of its file.
        window: of that view.
    """

    path: Path
    window: Window


@dataclass(frozen=True)
class CutOut:
    """A photograph without distortion, cut out.

    Attributes:
        image: (4, S, S) linear Rec.709, straight alpha.
        window: what it shows.
        known: left, top, right, bottom of the pixels that the photograph has; beyond them alpha is 0 and means nothing.
        cut: the photograph's border cuts the object.
        way: how the mask was found.
    """

    image: Tensor
    window: Window
    known: tuple[int, int, int, int]
    cut: bool
    way: str


def read_photograph(path: Path, lens: Lens) -> Tensor:
    """(4, H, W) linear, upright.

    Raises:
        InputImageError: it cannot be read, or the lens is of a picture of another shape.
    """
    image = read_image(path)
    _check_shape(path, lens, *image.shape[1:])
    return image


def quick_look(path: Path, lens: Lens) -> Tensor:
    """(1, H, W) grey levels in [0, 1] as the file has them, upright; a large JPEG is decoded at a half or a quarter.

    Raises:
        InputImageError: as `read_photograph`, as far as a glance shows.
    """
    try:
        with Image.open(path) as picture:
            picture.draft("L", (_GLANCE, _GLANCE))
            grey = ImageOps.exif_transpose(picture).convert("L")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):  # What Pillow does not read, we may.
        return srgb_from_linear(read_photograph(path, lens)[:3]).mean(dim=0, keepdim=True)
    _check_shape(path, lens, grey.height, grey.width)
    return torch.from_numpy(np.asarray(grey, np.float32) / 255.0)[None]


def _check_shape(path: Path, lens: Lens, height: int, width: int) -> None:
    """Raises `InputImageError` where a lens is of a picture of another shape."""
    # As much as rounding can do to either side of a scaled picture.
    if abs(width * lens.height / (height * lens.width) - 1.0) > 1.0 / min(width, height, lens.width, lens.height):
        size = f"{lens.width}x{lens.height}"
        raise InputImageError(f"{path}: its camera is of {size} pixels, it has {width}x{height}; correct the camera")


def cut_out(
    photograph: PosedPhotograph, table: RayTable, side: int, painted: PaintedMask | None, progress: Progress
) -> CutOut:
    """The view of a photograph.

    Args:
        table: of its lens.
        side: pixels of the view.
        painted: goes before every other way to find the object.
        progress: is told what is done.
    Raises:
        InputImageError: it cannot be read, or no object is found.
    """
    name = photograph.path.name
    progress(0.0, f"reading {name}")
    image = read_photograph(photograph.path, photograph.lens)
    if photograph.mask is not None:
        image = with_mask(image, photograph.mask, read_orientation(photograph.path)[2])
    else:
        alpha = image[3]
        if (whole_object := solid(alpha)) is not alpha:  # See-through all over.
            image = torch.cat([image[:3], whole_object[None]])
    progress(0.3, f"undistorting {name}")
    own = photograph.mask is not None or bool((image[3] < 0.5).any())
    longest = _BOX if own or painted is not None else MAXIMUM_SIDE
    whole = whole_window(table, min(longest, max(image.shape[1:])))
    seen, known = undistorted(image, table, whole.K, whole.width, whole.height)
    progress(0.4, f"cutting out {name}")
    if painted is not None:
        alpha, way = whole.of(read_mask(painted.path), painted.window), PAINTED
    elif own:
        alpha, way = seen[3] * known, "alpha" if photograph.mask is None else photograph.mask_way
    else:
        ways: list[str] = []
        alpha = foreground(seen, photograph.path, lambda _, way: ways.append(way))[3] * known
        way = ways[0]
    if not sees_something(alpha) or bool((alpha > 0.5)[known].all()):
        raise InputImageError(f"{photograph.path}: by {way} nothing or everything is the object; mend the mask")
    progress(0.8, f"undistorting {name}")
    window = around(whole, alpha, known, side) if painted is None else painted.window.resized(side)
    view, shown = undistorted(image, table, window.K, side, side)
    if painted is not None:
        view[3] = window.of(read_mask(painted.path), painted.window)
    elif not own:
        view[3] = window.of(alpha, whole)
    view[3] *= shown
    return CutOut(view, window, known_rectangle(shown), is_cut(alpha, known), way)
