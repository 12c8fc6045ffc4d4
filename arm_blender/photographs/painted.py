"""The masks that a user has painted on the views of an earlier run, and on those that it had no use for."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import torch

from ..errors import InputImageError
from ..views.mask_files import FOLDER as MASKS
from ..views.mask_files import read_mask
from ..views.transforms_json import TRANSFORMS
from .cut_out import PaintedMask
from .framing import Window

UNUSED = "unused.json"
"""As transforms.json, of the pictures that became no view because of their masks: a better one can be painted."""

PHOTOGRAPH = "photograph"
"""Field of a frame: the name of the photograph that it was made of."""


def begin(folder: Path, made: Path) -> dict[str, PaintedMask]:
    """Copies what stays of an older `folder` into `made`; the masks that were painted on its pictures, by their names.

    Raises:
        InputImageError: a painted mask is not as large as its view.
    """
    if not folder.is_dir():
        made.mkdir()
        return {}
    shutil.copytree(folder, made, symlinks=True)
    (made / UNUSED).unlink(missing_ok=True)
    painted = {}
    for older in (*older_views(folder / TRANSFORMS), *older_views(folder / UNUSED)):
        (made / older.picture).unlink(missing_ok=True)
        mask, window = folder / MASKS / older.picture, older.window
        if mask.is_file():
            height, width = read_mask(mask).shape
            if (width, height) != (window.width, window.height):
                size = f"{window.width}x{window.height}"
                raise InputImageError(f"{mask}: {width}x{height} pixels, its view has {size}; paint it at that size")
            painted[Path(older.picture).stem] = PaintedMask(mask, window)
    return painted


@dataclass(frozen=True)
class OlderView:
    """A picture that was made before.

    Attributes:
        picture: name of its file.
        photograph: that it was made of, by its name.
        window: that it shows.
    """

    picture: str
    photograph: str
    window: Window


def older_views(transforms: Path) -> list[OlderView]:
    """The pictures of a transforms.json or of `UNUSED`; none where the file is somebody else's."""
    try:
        data = json.loads(transforms.read_text(encoding="utf-8-sig"))
        views = []
        for frame in data["frames"]:
            if PHOTOGRAPH in frame and Path(frame["file_path"]).name == frame["file_path"]:
                fields = data | frame
                K = torch.eye(3, dtype=torch.float64)
                K[0, 0], K[1, 1], K[0, 2], K[1, 2] = (float(fields[name]) for name in ("fl_x", "fl_y", "cx", "cy"))
                window = Window(K, int(fields["w"]), int(fields["h"]))
                views.append(OlderView(frame["file_path"], str(frame[PHOTOGRAPH]), window))
    except (OSError, ValueError, TypeError, LookupError):
        return []
    return views
