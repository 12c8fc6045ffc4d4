"""Which way pictures get their cameras, by stated rules; and those that are solved, as a folder of clean views."""

import logging
import shutil
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from .. import views
from ..errors import ArmError, CameraError, InputImageError, OutputError
from ..knobs import CamerasName
from ..machine.files import write_json
from ..machine.picture_files import is_video, pictures_in
from ..progress import Progress, part
from ..views import LeaveOut
from ..views.foreground import Heard, unheard
from ..views.mask_files import FOLDER as MASKS
from ..views.mask_files import mask_beside
from ..views.rigs import AZIMUTHS_DEG
from ..views.transforms_json import TRANSFORMS
from .cameras.solving import SolvingOptions, solved
from .capture import Capture
from .clean_views import CleaningOptions, clean_views
from .colmap.model import model_folder
from .cut_out import PAINTED
from .kept import KEPT, Kept, kept_of, read_kept
from .pictures import looked_at, photographs_in
from .solved import mask_name, solved_capture
from .video import frames_of

logger = logging.getLogger(__name__)

FOUND = "found-masks"
"""In a folder of views: the masks that were found in the photographs, for views that are made anew."""


@dataclass(frozen=True)
class Way:
    """Where cameras come from.

    Attributes:
        cameras: "solve": from the pictures themselves; "file": they are given; "rig": six are known; "single": assumed.
        why: the rule that says so.
    """

    cameras: Literal["solve", "file", "rig", "single"]
    why: str


def way_of(path: Path, wish: CamerasName) -> Way:
    """Which way the pictures at `path` get their cameras.

    Raises:
        ArmError: the way that is wished for does not do.
        InputImageError: a picture of the folder cannot be read, and the choice needs it.
    """
    if wish == "solve" and not (path.is_dir() or is_video(path)):
        raise ArmError(f"--cameras solve: {path} is no folder of photographs and no video; give one")
    if wish in ("rig", "file") and is_video(path):
        raise ArmError(f"--cameras {wish}: {path} is a video, whose cameras can only be solved; leave it out")
    if wish != "auto":
        return Way(wish, f"--cameras {wish}")
    if is_video(path):
        return Way("solve", "a video comes without cameras")
    if has_cameras(path):
        return Way("file", f"{TRANSFORMS} or a model of COLMAP says them")
    pictures = _pictures(path)
    if len(pictures) < 2:
        return Way("single", "there is one picture")
    if len(pictures) == len(AZIMUTHS_DEG) and _is_rig(pictures):
        return Way("rig", f"{len(pictures)} square pictures that no camera took")
    return Way("solve", f"{len(pictures)} photographs without cameras")


def solved_views(
    path: Path,
    folder: Path,
    options: SolvingOptions,
    cleaning: CleaningOptions,
    progress: Progress,
    left_out: LeaveOut,
    heard: Heard = unheard,
) -> dict[str, Any]:
    """Writes the clean views of photographs whose cameras are solved; those of an earlier run are kept.

    Where masks were painted since, or taken away, or other views are asked for, those are made anew with the cameras
    that are kept.

    Args:
        path: a folder of photographs, or a video.
        folder: of the views.
        options: of the solver.
        cleaning: of the views.
        progress: told at least every second.
        left_out: told which pictures became no view, and why.
        heard: told how each view was cut out.
    Returns:
        How the cameras were solved, and how far they are to be trusted, for the report; JSON types.
    Raises:
        ArmError: as `solved` and `clean_views`.
    """
    if folder.resolve() == path.resolve():
        raise ArmError(f"{folder}: holds the pictures, and would be written over; choose another --output")
    source = _source(path, options)
    kept, painted = kept_of(folder, source), _painted(folder)
    if kept is not None and (kept.painted, kept.views) != (painted, cleaning.views):
        kept = _cleaned_anew(path, folder, kept, painted, cleaning, progress)
    reused = kept is not None
    if kept is None:
        kept = _solved(path, folder, Kept(source, {}, {}, [], [], painted, cleaning.views), options, progress)
    for name, way in kept.ways:
        heard(name, way)
    for name, reason in kept.left_out.items():
        left_out(name, reason)
    return kept.facts | ({"reused": True} if reused else {})


def _solved(
    path: Path,
    folder: Path,
    asked: Kept,
    options: SolvingOptions,
    progress: Progress,
) -> Kept:
    """The views of photographs whose cameras are solved, and the masks that were found, in `folder`.

    Args:
        asked: what the views depend on; the rest is found.
    """
    ways: list[tuple[str, str]] = []
    with tempfile.TemporaryDirectory(prefix="arm-photographs-") as name:
        masks = Path(name, "masks")
        masks.mkdir()
        paths = _photographs(path, Path(name), part(progress, 0.0, 0.1))

        def heard(picture: str, way: str) -> None:
            ways.append((picture, way))

        found = solved(paths, path, masks, options, part(progress, 0.1, 0.75), heard)
        kept = replace(asked, facts=found.facts, found=ways)
        kept = _cleaned(found.capture, folder, kept, part(progress, 0.75, 1.0))
        _keep_masks(found.capture, folder / FOUND)
    write_json(folder / KEPT, asdict(kept))
    return kept


def _cleaned_anew(
    path: Path,
    folder: Path,
    kept: Kept,
    painted: dict[str, list[int]],
    cleaning: CleaningOptions,
    progress: Progress,
) -> Kept:
    """As `_solved`, with the cameras and the masks of an earlier run: other masks were painted, or views asked for."""
    with tempfile.TemporaryDirectory(prefix="arm-photographs-") as name:
        paths = _photographs(path, Path(name), part(progress, 0.0, 0.3))
        try:
            capture = solved_capture(folder, paths, folder / FOUND)
        except CameraError as error:  # Of an earlier version: its views are read with the painted masks beside them.
            logger.info("%s", error)
            return kept
        kept = replace(kept, painted=painted, views=cleaning.views)
        kept = _cleaned(capture, folder, kept, part(progress, 0.3, 1.0))
    write_json(folder / KEPT, asdict(kept))
    return kept


def _cleaned(capture: Capture, folder: Path, kept: Kept, progress: Progress) -> Kept:
    """Writes the views; what is kept, with what was said of them."""
    reasons: dict[str, str] = {}
    by_hand: list[str] = []

    def heard(picture: str, way: str) -> None:
        if way == PAINTED:
            by_hand.append(picture)

    clean_views(capture, folder, CleaningOptions(views=kept.views), progress, reasons.__setitem__, heard)
    return replace(kept, left_out=reasons, by_hand=by_hand)


def _keep_masks(capture: Capture, folder: Path) -> None:
    """Copies the masks that were found in the photographs into `folder`, in place of those of an earlier capture.

    Raises:
        OutputError: they cannot be written.
    """
    try:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for photograph in capture.photographs:
            if photograph.mask is not None:
                shutil.copyfile(photograph.mask, folder / mask_name(photograph.path.name))
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror}); free space or change --output") from error


def _photographs(path: Path, folder: Path, progress: Progress) -> list[Path]:
    """The photographs at `path`; those of a video are written into a new folder in `folder`."""
    if not is_video(path):
        return photographs_in(path)
    frames = folder / "frames"
    frames.mkdir()
    return frames_of(path, frames, progress)


def are_views_of(folder: Path, path: Path) -> bool:
    """Whether the views in `folder` were made of the pictures at `path` as they are now."""
    try:
        return bool(read_kept(folder).source["files"] == _source(path, SolvingOptions())["files"])
    except (OSError, ValueError, KeyError, TypeError):
        return False


def has_cameras(path: Path) -> bool:
    """Whether what is at `path` comes with cameras of its own; else they are assumed, or solved."""
    return views.has_cameras(path) or (path.is_dir() and model_folder(path) is not None)


def _pictures(path: Path) -> list[Path]:
    """Of a folder; none of anything else."""
    try:
        return pictures_in(path) if path.is_dir() else []
    except OSError as error:
        raise InputImageError(f"{path}: cannot be read ({error.strerror}); check its rights") from error


def _is_rig(pictures: list[Path]) -> bool:
    """Whether pictures are square and know no focal length: made by a program for a known rig, which wants one size."""
    try:
        looks = [looked_at(picture) for picture in pictures]
    except InputImageError:
        return True  # Whoever reads them next says what is wrong, or knows formats that this does not.
    return looks[0].width == looks[0].height and not any(look.focal for look in looks)


def _source(path: Path, options: SolvingOptions) -> dict[str, Any]:
    """What the views depend on, as JSON types: another picture, or a newer one, asks for another solution."""
    files = [path] if is_video(path) else photographs_in(path)
    files += [mask for file in files if (mask := mask_beside(file, file.parent)) is not None]
    states = [(file.name, file.stat()) for file in files if file.is_file()]
    return {"seed": options.seed, "files": [[name, state.st_size, state.st_mtime_ns] for name, state in states]}


def _painted(folder: Path) -> dict[str, list[int]]:
    """Size and time of every mask that was painted on a view: another one asks for views made anew."""
    states = {path.name: path.stat() for path in sorted((folder / MASKS).glob("*.png"))}
    return {name: [state.st_size, state.st_mtime_ns] for name, state in states.items()}
