"""Views of whatever there is: as they are where they do, and made first where they are photographs or a video."""

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

from .. import views
from ..errors import CameraError
from ..progress import Progress, part, silent
from ..report import Report
from ..structures import ViewSet
from ..views import ViewOptions, view_set
from ..views.multiview import View
from .cameras.solving import SolvingOptions
from .clean_views import CleaningOptions, clean_views
from .foreign import needs_cleaning, read_capture
from .way import solved_views, way_of

_MAKING = 0.9
"""Of the progress, what making views takes where they have to be made."""


def load_views(
    path: Path,
    folder: Path | None,
    options: ViewOptions,
    solving: SolvingOptions,
    report: Report,
    progress: Progress = silent,
) -> ViewSet:
    """As `views.load_views`, of photographs as well, whether other programs posed them or nobody did.

    Args:
        path: as there; or a transforms.json, or a model of COLMAP, of any number of photographs with lenses that bend;
            or a folder of photographs, or a video, without cameras.
        folder: where views go, if any have to be made; None keeps them until the program ends.
        options: for what the files do not say.
        solving: of cameras, where nobody says them.
        report: is told by which rule cameras were found and how far they are to be trusted, how each picture was cut
            out, and what is not used.
        progress: is told each picture.
    Raises:
        CameraError: as `views.load_views`; or what is read would be written over.
        ArmError: as there, as `read_capture`, `clean_views` and `solved_views`.
    """
    read = read_views(path, folder, options, solving, report, progress)
    return replace(view_set(read, path, options.weights, report.leave_out), length=options.length)


def read_views(
    path: Path,
    folder: Path | None,
    options: ViewOptions,
    solving: SolvingOptions,
    report: Report,
    progress: Progress = silent,
) -> list[View]:
    """All views that `load_views` chooses from.

    Raises:
        as `load_views`.
    """
    way = way_of(path, options.cameras_from)
    report.photographs = {"cameras": way.cameras, "why": way.why}
    if way.cameras != "solve" and not needs_cleaning(path):
        return views.read_views(path, options, progress, report.leave_out, report.note_mask)
    place = make_views(path, folder, options, solving, report, part(progress, 0.0, _MAKING))
    # How they were cut out has been told.
    return views.read_views(place, options, part(progress, _MAKING, 1.0), report.leave_out)


def make_views(
    path: Path,
    folder: Path | None,
    options: ViewOptions,
    solving: SolvingOptions,
    report: Report,
    progress: Progress = silent,
) -> Path:
    """The folder of clean views of photographs: `folder`, or a new one.

    Args: and Raises: as `load_views`.
    """
    if folder is not None and (path if path.is_dir() else path.parent).resolve() == folder.resolve():
        raise CameraError(f"{folder}: is read, and would be written over; choose another --output")
    place, cleaning = _place(folder), CleaningOptions(views=options.photo_views)
    if way_of(path, options.cameras_from).cameras == "solve":
        facts = solved_views(path, place, solving, cleaning, progress, report.leave_out, report.note_mask)
        report.photographs |= facts
        for reason in facts["doubts"]:
            report.doubt(f"the cameras of {path.name}: {reason}")
        return place
    capture = read_capture(path, part(progress, 0.0, 0.05))
    return clean_views(capture, place, cleaning, part(progress, 0.05, 1.0), report.leave_out, report.note_mask)


def views_are_made(path: Path, options: ViewOptions) -> bool:
    """Whether views of what is at `path` have to be made first.

    Raises:
        ArmError: as `way_of`.
    """
    return way_of(path, options.cameras_from).cameras == "solve" or needs_cleaning(path)


def _place(folder: Path | None) -> Path:
    """`folder`, or a new one that is gone when the program ends: until then somebody may look at its pictures."""
    return folder or Path(tempfile.mkdtemp(dir=_kept().name), "views")


@cache
def _kept() -> "tempfile.TemporaryDirectory[str]":
    """The folder of views that were made for the moment; it goes with the program."""
    return tempfile.TemporaryDirectory()
