"""A transforms.json of nerfstudio, instant-ngp or Polycam as a capture: any number of frames, any lens."""

from pathlib import Path

from torch import Tensor, zeros

from ..errors import CameraError, InputImageError
from ..views.image_io import read_orientation
from ..views.posed_frame import PINHOLES, PosedFrame
from ..views.transforms_json import read_frames
from .capture import Capture, Lens, PosedPhotograph
from .orientation import oriented

_FISHEYES = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
"""Lenses whose k1 to k4 are a polynomial of the angle; the shorter ones are the longest with zeros."""


def capture_of_transforms(path: Path) -> Capture:
    """The photographs of a transforms.json.

    Frames whose picture is missing are left out, in one line.

    Raises:
        CameraError: as `read_frames`; or a lens is unknown. The line names the file, the frame and the field.
        InputImageError: no frame has a picture.
    """
    frames, missing = read_frames(path)
    if not frames:
        raise InputImageError(f"{missing[0]}: no such picture in {path.parent}, nor one of the others; add the files")
    left_out: dict[str, str] = {}
    if missing:
        first = missing[0].removeprefix(f"{path}: ")
        left_out[f"{len(missing)} of {len(frames) + len(missing)} frames"] = (
            f"their pictures are missing, first {first}"
        )
    photographs = []
    for frame in frames:
        try:
            lens, c2w = _camera(frame)
        except InputImageError as error:  # One damaged picture spoils no capture.
            left_out[frame.image.name] = str(error)
            continue
        photographs.append(PosedPhotograph(frame.image, c2w, lens, frame.mask))
    if not photographs:
        raise InputImageError(next(reversed(left_out.values())))
    return Capture(tuple(photographs), zeros(0, 3).double(), left_out)


def _camera(frame: PosedFrame) -> tuple[Lens, Tensor]:
    """The lens and the pose of a frame's picture as it is shown."""
    width, height, orientation = read_orientation(frame.image)
    sideways = orientation in (5, 6, 7, 8)
    stated = frame.fields.get("w"), frame.fields.get("h")
    wide = [isinstance(side, int | float) and not isinstance(side, bool) for side in stated]
    if sideways and all(wide) and (stated[0] > stated[1]) == (width > height):  # type: ignore[operator]
        return oriented(_lens(frame, width, height), frame.c2w.double(), orientation, frame.where)
    if sideways:
        width, height = height, width
    return _lens(frame, width, height), frame.c2w.double()


def _lens(frame: PosedFrame, width: int, height: int) -> Lens:
    """The lens of a frame, of a picture of that size, by COLMAP's models."""
    K = frame.camera(width, height).K.double()
    pinhole = tuple(float(K[row, column]) for row, column in ((0, 0), (1, 1), (0, 2), (1, 2)))
    given = frame.distortion

    def bent(model: str, *names: str) -> Lens:
        return Lens(model, (*pinhole, *(given.get(name, 0.0) for name in names)), width, height)

    if frame.model in _FISHEYES:
        if given.keys() <= {"k1", "k2", "k3", "k4"}:
            return bent("OPENCV_FISHEYE", "k1", "k2", "k3", "k4")
    elif frame.model in (*PINHOLES, "FULL_OPENCV"):
        if not given:
            return Lens("PINHOLE", pinhole, width, height)
        if given.keys() <= {"k1", "k2", "p1", "p2"}:
            return bent("OPENCV", "k1", "k2", "p1", "p2")
        # k4 alone is a fourth coefficient to some programs, and to OpenCV the first of a denominator.
        if frame.model == "FULL_OPENCV" or given.keys() <= {"k1", "k2", "k3", "p1", "p2"}:
            return bent("FULL_OPENCV", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    else:
        line = f"{frame.where}: camera_model {frame.model} is unknown"
        raise CameraError(f"{line}; give OPENCV, FULL_OPENCV or OPENCV_FISHEYE, or undistort the pictures first")
    names = ", ".join(given)
    line = f"{frame.where}: camera_model {frame.model} with {names} says not how the lens bends"
    raise CameraError(f"{line}; name FULL_OPENCV or OPENCV_FISHEYE, or undistort the pictures first")
