"""What other programs wrote of a capture, and whether it has to be cleaned before it does as views."""

from pathlib import Path

from ..errors import CameraError, InputImageError
from ..knobs import MOST_VIEWS, USUAL_VIEWS
from ..progress import Progress
from ..views.transforms_json import read_frames, transforms_in
from .capture import Capture
from .colmap.model import capture_of_colmap, model_folder
from .transforms_capture import capture_of_transforms

PROJECTS = {
    ".rcproj": "RealityCapture",
    ".rsproj": "RealityScan",
    ".psx": "Metashape",
    ".psz": "Metashape",
    ".xml": "Metashape or RealityCapture",
}
"""Files of programs that keep cameras in a way of their own, and whose they are."""


def needs_cleaning(path: Path) -> bool:
    """Whether `path` holds photographs with cameras that do not do as views as they are.

    A transforms.json of more than `USUAL_VIEWS` frames that are no clean views, or of more than `MOST_VIEWS`, with a
    bent lens or missing pictures, or a model of COLMAP.

    Raises:
        CameraError: a transforms.json is malformed, or the file is another program's own.
        InputImageError: `path` cannot be read.
    """
    program = PROJECTS.get(path.suffix.lower())
    if program is not None and not path.is_dir():
        line = f"{path}: cameras of {program} are read from its export for COLMAP"
        raise CameraError(f"{line}; export cameras and undistorted images so, and give the folder with sparse/0")
    try:
        transforms = _transforms(path)
        if transforms is None:
            return path.is_dir() and model_folder(path) is not None
        if not transforms.exists():
            return False
        frames, missing = read_frames(transforms)
    except OSError as error:
        raise InputImageError(f"{path}: cannot be read ({error.strerror}); check the path and its rights") from error
    most = MOST_VIEWS if all("known" in frame.fields for frame in frames) else USUAL_VIEWS
    return bool(missing) or len(frames) > most or any(frame.is_bent for frame in frames)


def read_capture(path: Path, progress: Progress) -> Capture:
    """The capture at a `path` that `needs_cleaning`.

    Raises:
        CameraError, InputImageError: the files do not do; the line names the file and the remedy.
        ArmError: pycolmap is needed, and not there.
    """
    transforms = _transforms(path)
    return capture_of_colmap(path, progress) if transforms is None else capture_of_transforms(transforms)


def _transforms(path: Path) -> Path | None:
    """The transforms.json that `path` is or holds."""
    if path.suffix.lower() == ".json":
        return path
    return transforms_in(path) if path.is_dir() else None
