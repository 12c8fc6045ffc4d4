"""Which way pictures get their cameras, by stated rules; and those that are solved, as a folder of clean views."""

import json
import logging
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from .. import views
from ..errors import ArmError, InputImageError
from ..knobs import CamerasName
from ..machine.files import write_json
from ..progress import Progress, part
from ..views import LeaveOut
from ..views.foreground import Heard, unheard
from ..views.image_io import pictures_in
from ..views.rigs import AZIMUTHS_DEG
from ..views.transforms_json import TRANSFORMS
from .cameras.solving import SolvingOptions, solved
from .clean_views import CleaningOptions, clean_views
from .colmap.model import model_folder
from .pictures import looked_at, photographs_in
from .video import frames_of, is_video

logger = logging.getLogger(__name__)

KEPT = "cameras.json"
"""In a folder of views: of which pictures they are, and how far their cameras are to be trusted."""


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
    progress: Progress,
    left_out: LeaveOut,
    heard: Heard = unheard,
) -> dict[str, Any]:
    """Writes the clean views of photographs whose cameras are solved; those of an earlier run are kept.

    Args:
        path: a folder of photographs, or a video.
        folder: of the views.
        options: of the solver.
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
    kept = _kept(folder, source)
    if kept is not None:
        for name, reason in kept["left_out"].items():
            left_out(name, reason)
        return kept["facts"] | {"reused": True}
    reasons: dict[str, str] = {}

    def note(name: str, reason: str) -> None:
        reasons[name] = reason
        left_out(name, reason)

    with tempfile.TemporaryDirectory(prefix="arm-photographs-") as name:
        frames, masks = Path(name, "frames"), Path(name, "masks")
        frames.mkdir()
        masks.mkdir()
        paths = frames_of(path, frames, part(progress, 0.0, 0.1)) if is_video(path) else photographs_in(path)
        found = solved(paths, path, masks, options, part(progress, 0.1, 0.75), heard)
        clean_views(found.capture, folder, CleaningOptions(), part(progress, 0.75, 1.0), note)
    write_json(folder / KEPT, {"source": source, "facts": found.facts, "left_out": reasons})
    return found.facts


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
    states = [(file.name, file.stat()) for file in files if file.is_file()]
    return {"seed": options.seed, "files": [[name, state.st_size, state.st_mtime_ns] for name, state in states]}


def _kept(folder: Path, source: dict[str, Any]) -> dict[str, Any] | None:
    """What an earlier run wrote of the same pictures, where its views are still there."""
    try:
        kept = json.loads((folder / KEPT).read_text(encoding="utf-8"))
        frames = json.loads((folder / TRANSFORMS).read_text(encoding="utf-8"))["frames"]
        same = kept["source"] == source and all((folder / frame["file_path"]).is_file() for frame in frames)
        return {"facts": dict(kept["facts"]), "left_out": dict(kept["left_out"])} if same else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
