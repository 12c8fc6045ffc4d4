"""The six views as a folder that a user may look at, edit, draw anew in parts, and feed back: pictures and cameras."""

import json
import shutil
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...errors import InputImageError, OutputError
from ...graphics.cameras import Camera
from ...graphics.color import linear_from_srgb
from ...machine.files import replace_folder, staging, write_json
from ..foreground import foreground
from ..image_io import write_png
from ..transforms_json import TRANSFORMS, write_transforms

ORIGIN = "zero123plus"
"""The field of a frame that says how its view was made; other readers pass over it."""

_VIEWS = 6


def check_folder(folder: Path) -> None:
    """Makes sure, before any work starts, that `folder` is free or a folder.

    Raises:
        OutputError: a file is in the way.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file where a folder has to be; move it away or change --output")


def read_seeds(folder: Path) -> tuple[int, ...]:
    """The seeds of the six views in a folder that `write_views` has made.

    Raises:
        InputImageError: there is none, or not all six have a seed any more.
    """
    try:
        data = json.loads((folder / TRANSFORMS).read_text(encoding="utf-8-sig"))
        seeds = tuple(int(frame[ORIGIN]["seed"]) for frame in data["frames"])
    except (OSError, ValueError, TypeError, LookupError):
        seeds = ()
    if len(seeds) != _VIEWS:
        raise InputImageError(f"{folder}: has no six views of zero123plus to keep; run once without --reseed")
    return seeds


def write_views(
    folder: Path, images: dict[int, Tensor], cameras: tuple[Camera, ...], seeds: tuple[int, ...], **origin: Any
) -> None:
    """Writes views and transforms.json, whole or not at all.

    Args:
        folder: is made where it is missing. What is in it stays, but for the pictures of `images`; so do the frames
            of the other views, with whatever the user has changed in them.
        images: the views by their place in the rig, each (3, S, S) sRGB in [0, 1] on a plain background, which
            becomes transparent; one on another background stays opaque, for the user to cut out.
        cameras: all six, of that size.
        seeds: all six.
        origin: what else a frame says of how it was made.
    Raises:
        OutputError: a file cannot be written; the folder is as it was.
    """
    with staging(folder.parent) as stage:
        made = stage / folder.name
        if folder.is_dir():
            shutil.copytree(folder, made, symlinks=True)
        else:
            made.mkdir()
        for index, image in images.items():
            write_png(made / _name(index), cut_out(image, folder / _name(index)), srgb=True)
        _write_frames(made / TRANSFORMS, images, cameras, [{"seed": seed} | origin for seed in seeds])
        replace_folder(folder, made, stage / "older")


def cut_out(image: Tensor, path: Path) -> Tensor:
    """(4, S, S) linear Rec.709 and straight alpha of a view (3, S, S) in sRGB; opaque where that cannot be seen."""
    opaque = torch.cat([linear_from_srgb(image), torch.ones_like(image[:1])])
    try:
        return foreground(opaque, path)
    except InputImageError:  # Read back it is refused by its name: by then the user can look at it.
        return opaque


def _name(index: int) -> str:
    return f"{index}.png"


def _write_frames(
    path: Path, images: dict[int, Tensor], cameras: tuple[Camera, ...], origins: list[dict[str, Any]]
) -> None:
    """transforms.json with the frames of `images` made new, and the others as they are in it."""
    older = json.loads(path.read_text(encoding="utf-8-sig")) if len(images) < _VIEWS else None
    write_transforms(path, [_name(index) for index in range(_VIEWS)], cameras)
    data = json.loads(path.read_text(encoding="utf-8"))
    frames = data.pop("frames")
    for frame, origin in zip(frames, origins, strict=True):
        frame[ORIGIN] = origin
    if older is not None:
        # The intrinsics go into the new frames: those of the file may be the user's.
        for index in images:
            older["frames"][index] |= data | frames[index]
        write_json(path, older)
    else:
        write_json(path, data | {"frames": frames})
