"""Masks that lie beside pictures as files of their own: where other programs put them, how they are read, and begun."""

from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from ..errors import InputImageError, OutputError
from ..graphics.color import srgb_from_linear
from ..machine.picture_files import SUFFIXES, pictures_in
from .foreground import Heard, foreground, unheard
from .image_io import read_image, read_orientation, write_png
from .opacity import solid
from .preprocess import check_size

FOLDER = "masks"
"""Of masks, beside the pictures or the folder of the pictures."""

MASK_FILE = "mask file"
"""The way of a mask that lies beside its picture."""

_QUARTERS = {6: -1, 8: 1}
"""Quarter turns, counter-clockwise, that set a picture of that EXIF orientation upright."""


def mask_beside(picture: Path, root: Path) -> Path | None:
    """The mask of a picture where one lies: `NAME.mask.png`, `masks/NAME.png`, or `masks/NAME.SUFFIX.png`.

    Args:
        picture: inside `root`.
        root: of the capture. Its `masks/` repeats the folders of the pictures, with or without the outermost one.
    """
    beside = [picture.with_name(f"{name}.mask.png") for name in (picture.name, picture.stem)]
    relative = picture.relative_to(root) if picture.is_relative_to(root) else Path(picture.name)
    shorter = Path(*relative.parts[1:]) if len(relative.parts) > 1 else relative
    for place in dict.fromkeys((relative, shorter, Path(picture.name))):
        named = root / FOLDER / place
        # As COLMAP names them, after the whole name; then as most others.
        beside += [named.with_name(f"{place.name}.png"), *(named.with_suffix(suffix) for suffix in SUFFIXES)]
    # A folder of pictures called masks is its own.
    return next((path for path in beside if path.is_file() and path.resolve() != picture.resolve()), None)


def read_mask(path: Path) -> Tensor:
    """(H, W) float32 in [0, 1]: the alpha of a picture that has one, else its grey level as it is stored.

    Raises:
        InputImageError: as `read_image`.
    """
    image = read_image(path)
    if bool((image[3] < 0.5).any()):
        return image[3]
    return srgb_from_linear(image[:3]).mean(dim=0)


def with_mask(image: Tensor, mask: Path, orientation: int = 1) -> Tensor:
    """`image` (4, H, W), upright, with the alpha that a file has for it, at any size.

    What the file has most of is the object: a mask may be grey (`opacity.solid`), or hold the numbers of labels.

    Args:
        orientation: by EXIF, of the image's file: a mask that lies as that file stores it is turned along.
    Raises:
        InputImageError: the mask is of another shape, or does not do as a picture.
    """
    alpha = read_mask(mask)
    highest = float(alpha.max())
    if 0.0 < highest < 0.5 and bool(((alpha == 0.0) | (alpha == highest)).all()):
        alpha = alpha / highest  # A label such as 1 of 255.
    if alpha.shape != image.shape[1:]:
        (height, width), (rows, columns) = image.shape[1:], alpha.shape
        if orientation in _QUARTERS and (rows > columns) != (height > width):
            alpha = torch.rot90(alpha, _QUARTERS[orientation])
            rows, columns = alpha.shape
        # A pixel of rounding in a smaller mask is no other shape.
        if abs(columns * height / (rows * width) - 1.0) > 1.0 / min(rows, columns, height, width):
            raise InputImageError(f"{mask}: {columns}x{rows} pixels for a picture of {width}x{height}; give one alike")
        mode = "area" if rows > height else "bilinear"
        alpha = interpolate(alpha[None, None], size=(height, width), mode=mode)[0, 0]
    return torch.cat([image[:3], solid(alpha)[None]])


def read_cut_out(picture: Path, mask: Path | None, heard: Heard = unheard) -> Tensor:
    """(4, H, W) linear of a picture, cut out by the mask of a file where there is one, else as by `foreground`.

    Args:
        heard: is told by which way.
    Raises:
        as `foreground` and `with_mask`.
    """
    image = read_image(picture)
    if mask is None:
        return foreground(image, picture, heard)
    check_size(image, picture)
    image = with_mask(image, mask, read_orientation(picture)[2])
    heard(picture.name, MASK_FILE)
    return image


def mask_to_paint(picture: Path, root: Path) -> Path:
    """The file to paint a picture's mask on: the one that counts already, else a new one in `masks/`, as it is found.

    The new one is as large as the picture, white where the object is; black where no way finds one.

    Args:
        picture: inside `root`.
        root: as for `mask_beside`.
    Raises:
        InputImageError: the picture cannot be read.
        OutputError: the mask cannot be written.
    """
    there = mask_beside(picture, root)
    if there is not None:
        return there
    image = read_image(picture)
    try:
        alpha = foreground(image, picture)[3:]
    except InputImageError:
        alpha = torch.zeros_like(image[3:])
    place = root / FOLDER / (picture.relative_to(root) if picture.is_relative_to(root) else picture.name)
    alone = sum(other.stem == picture.stem for other in pictures_in(picture.parent)) < 2
    place = place.with_name(f"{picture.stem if alone else picture.name}.png")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{place.parent}: cannot be made ({error.strerror}); check its rights") from error
    write_png(place, alpha, srgb=False)
    return place
