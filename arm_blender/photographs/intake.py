"""Views of whatever there is: as they are where they do, and cleaned first where they are photographs with cameras."""

import tempfile
from functools import cache
from pathlib import Path

from .. import views
from ..errors import CameraError
from ..progress import Progress, part, silent
from ..structures import ViewSet
from ..views import LeaveOut, ViewOptions, view_set
from ..views.foreground import Heard, unheard
from ..views.multiview import View
from .clean_views import clean_views
from .colmap_model import model_folder
from .foreign import needs_cleaning, read_capture

_CLEANING = 0.9
"""Of the progress, what cleaning takes where there is something to clean."""


def load_views(
    path: Path,
    folder: Path | None,
    options: ViewOptions | None = None,
    progress: Progress = silent,
    left_out: LeaveOut = unheard,
    heard: Heard = unheard,
) -> ViewSet:
    """As `views.load_views`, of photographs that other programs posed as well.

    Args:
        path: as there; or a transforms.json, or a model of COLMAP, of any number of photographs with lenses that bend.
        folder: where clean views go, if any have to be made; None keeps them until the program ends.
        options: for what the files do not say.
        progress: is told each picture.
        left_out: is told what is not used, and why: every photograph that becomes no view too.
        heard: is told how each picture was cut out.
    Raises:
        CameraError: as `views.load_views`; or what is read would be written over.
        ArmError: as there, as `read_capture` and as `clean_views`.
    """
    options = options or ViewOptions()
    read = read_views(path, folder, options, progress, left_out, heard)
    return view_set(read, path, options.weights, left_out)


def read_views(
    path: Path,
    folder: Path | None,
    options: ViewOptions,
    progress: Progress = silent,
    left_out: LeaveOut = unheard,
    heard: Heard = unheard,
) -> list[View]:
    """All views that `load_views` chooses from.

    Raises:
        as `load_views`.
    """
    if not needs_cleaning(path):
        return views.read_views(path, options, progress, left_out, heard)
    if folder is not None and (path if path.is_dir() else path.parent).resolve() == folder.resolve():
        raise CameraError(f"{folder}: is read, and would be written over; choose another --output")
    capture = read_capture(path, part(progress, 0.0, 0.05))
    place = clean_views(capture, _place(folder), None, part(progress, 0.05, _CLEANING), left_out, heard)
    # How they were cut out has been told.
    return views.read_views(place, options, part(progress, _CLEANING, 1.0), left_out)


def has_cameras(path: Path) -> bool:
    """Whether what is at `path` comes with cameras of its own; else they are assumed."""
    return views.has_cameras(path) or (path.is_dir() and model_folder(path) is not None)


def _place(folder: Path | None) -> Path:
    """`folder`, or a new one that is gone when the program ends: until then somebody may look at its pictures."""
    return folder or Path(tempfile.mkdtemp(dir=_kept().name), "views")


@cache
def _kept() -> "tempfile.TemporaryDirectory[str]":
    """The folder of views that were made for the moment; it goes with the program."""
    return tempfile.TemporaryDirectory()
