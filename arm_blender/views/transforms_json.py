"""transforms.json, in and out: the convention of the NeRF-synthetic set, and what nerfstudio and instant-ngp add.

A frame names a picture and its camera to world matrix in OpenGL axes. The intrinsics are `camera_angle_x` (radians), or
`fl_x, fl_y, cx, cy` in pixels of a picture of `w` x `h`; global, or per frame, which goes first. Ours are `weight`,
`known` (left, top, right and bottom of the pixels that a camera took, where others were added around them), `ground`
(height, Z, of what the object stands on), and `varying_exposure` (true where the camera exposed by itself).
"""

import json
import math
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..errors import CameraError, InputImageError
from ..graphics.cameras import Camera
from ..knobs import MOST_VIEWS
from ..machine.files import write_json
from ..machine.picture_files import SUFFIXES
from .mask_files import mask_beside
from .posed_frame import LARGEST, PosedFrame, number

TRANSFORMS = "transforms.json"
"""The file's name in a folder of views."""

_TRAINING = "transforms_train.json"
"""Its name where a set is cut in three, as NeRF-synthetic is; the others are for tests, and see the same object."""

_DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_STRAIGHT = 1e-6
"""Coefficients of a lens below which it bends nothing: a hundredth of a pixel at the border of a large picture."""

_RIGID_TOLERANCE = 1e-3
"""How far the rotation may be from orthonormal: six decimals in a file pass, a scale or a mirror does not."""


def transforms_in(folder: Path) -> Path | None:
    """The file with the cameras of a folder of views; None where there is none."""
    return next((folder / name for name in (TRANSFORMS, _TRAINING) if (folder / name).is_file()), None)


def read_transforms(path: Path) -> tuple[PosedFrame, ...]:
    """The frames of a transforms.json, in the file's order, if they do as views as they are.

    Raises:
        CameraError: as `read_frames`; or there are too many, or a lens is distorted.
        InputImageError: a picture does not exist.
    """
    frames, missing = read_frames(path)
    if missing:
        raise InputImageError(f"{missing[0]}: no such picture in {path.parent}; correct file_path or add the file")
    if len(frames) > MOST_VIEWS:
        raise CameraError(f"{path}: {len(frames)} frames; keep at most {MOST_VIEWS} that look from all around")
    for frame in frames:
        if frame.is_bent:
            reason = ", ".join(frame.distortion) or f"camera_model {frame.model}"
            raise CameraError(f"{frame.where}: the lens is distorted ({reason}); undistort the pictures first")
    return frames


def read_frames(path: Path) -> tuple[tuple[PosedFrame, ...], tuple[str, ...]]:
    """The frames of a transforms.json, in the file's order: however many, whatever their lenses.

    `applied_transform`, `scale` and the like say how a file's frame of reference came about; it is taken as it is.

    Returns:
        Those whose picture exists, and of each other one file and frame, for messages.
    Raises:
        CameraError: the file is missing or malformed, a matrix is not rigid, or a `file_path` leaves the folder. The
            line names the file, the frame and the field.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise CameraError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (ValueError, RecursionError) as error:  # Also bytes that are no UTF-8, and brackets without end.
        raise CameraError(f"{path}: no valid JSON ({error}); export it again") from error
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not frames:
        raise CameraError(f'{path}: no "frames"; give a list with file_path and transform_matrix per picture')
    shared = {key: value for key, value in data.items() if key != "frames"}
    read = [_read_frame(frame, shared, path, index) for index, frame in enumerate(frames)]
    there = tuple(frame for frame in read if isinstance(frame, PosedFrame))
    return there, tuple(where for where in read if isinstance(where, str))


def write_transforms(
    path: Path,
    images: Sequence[str],
    cameras: Sequence[Camera],
    weights: Sequence[float] | None = None,
    fields: Sequence[dict[str, Any]] | None = None,
    ground: float | None = None,
    varying_exposure: bool = False,
) -> None:
    """A transforms.json of pictures and their cameras, whole or not at all; `read_transforms` gives the same back.

    Args:
        path: of the file.
        images: paths of the pictures, relative to the file's folder.
        cameras: as many.
        weights: as many, or None where every view counts alike.
        fields: as many, or None: what else each frame says, such as `known`; other readers pass over it.
        ground: height (Z) of what the object stands on, where that is known.
        varying_exposure: the camera exposed by itself.
    Raises:
        ValueError: the numbers of images, cameras, weights and fields differ.
        OutputError: the file cannot be written.
    """
    intrinsics = [_intrinsics(camera) for camera in cameras]
    alike = all(fields == intrinsics[0] for fields in intrinsics)
    frames: list[dict[str, Any]] = []
    for image, camera, own in zip(images, cameras, intrinsics, strict=True):
        # A float32 prints the shortest decimals that give it back; as a float64 it would print seventeen.
        matrix = [[float(str(value)) for value in row] for row in camera.c2w.cpu().numpy()]
        frames.append({"file_path": image, "transform_matrix": matrix} | ({} if alike else own))
    if weights is not None:
        for frame, weight in zip(frames, weights, strict=True):
            frame["weight"] = float(weight)
    if fields is not None:
        for frame, more in zip(frames, fields, strict=True):
            frame |= more
    shared: dict[str, Any] = dict(intrinsics[0]) if alike else {}
    if ground is not None:
        shared["ground"] = ground
    if varying_exposure:
        shared["varying_exposure"] = True
    write_json(path, shared | {"frames": frames})


def _intrinsics(camera: Camera) -> dict[str, float]:
    """Fields that every reader understands: `camera_angle_x` for the oldest, pixels for the others."""
    focal_x, focal_y, center_x, center_y = (
        float(str(value)) for value in camera.K.cpu().numpy()[[0, 1, 0, 1], [0, 1, 2, 2]]
    )
    return {
        "camera_angle_x": 2.0 * math.atan(camera.width / (2.0 * focal_x)),
        "fl_x": focal_x,
        "fl_y": focal_y,
        "cx": center_x,
        "cy": center_y,
        "w": camera.width,
        "h": camera.height,
    }


def _read_frame(frame: Any, shared: dict[str, Any], path: Path, index: int) -> PosedFrame | str:
    """A frame; where its picture does not exist, only its name for messages."""
    where = f"{path}: frame {index}"
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str) or not frame["file_path"]:
        raise CameraError(f"{where}: no file_path; name the frame's picture")
    where = f"{where} ({frame['file_path']})"
    fields = shared | frame
    values = {name: number(fields.get(name), name, where) for name in _DISTORTION}
    distortion = {name: value for name, value in values.items() if value and abs(value) > _STRAIGHT}
    model = "OPENCV_FISHEYE" if fields.get("is_fisheye") else str(fields.get("camera_model") or "PINHOLE")
    weight = number(fields.get("weight"), "weight", where)
    if weight is not None and weight < 0.0:
        raise CameraError(f"{where}: weight is {weight:g}; give 0 or more")
    c2w = _rigid(fields.get("transform_matrix"), where)
    picture = _file(path, frame["file_path"], "file_path", where)
    if picture is None:
        return where
    mask = frame.get("mask_path")
    beside = _file(path, mask, "mask_path", where) if isinstance(mask, str) else None
    return PosedFrame(
        picture,
        c2w,
        fields,
        1.0 if weight is None else weight,
        where,
        model,
        distortion,
        beside or mask_beside(picture, path.parent),
    )


def _file(path: Path, named: str, field: str, where: str) -> Path | None:
    """A picture that a frame names, inside the folder of the file; the extension may be missing, or in capitals.

    A link is the user's own, and may lead anywhere; a name in a file may not.
    """
    place = path.parent / named.replace("\\", "/")
    try:
        inside = Path(os.path.abspath(place)).is_relative_to(os.path.abspath(path.parent))
        if not inside:
            raise CameraError(f"{where}: {field} leaves the folder; move the picture beside {path.name}")
        if _is_file(place):
            return place
        beside = sorted(place.parent.iterdir()) if place.parent.is_dir() and place.name else []
        endings = {f"{place.name}{suffix}": index for index, suffix in enumerate(SUFFIXES)}
        there = [other for other in beside if _without_case(other.name, place.name) in endings and _is_file(other)]
        return min(there, key=lambda other: endings[_without_case(other.name, place.name)], default=None)
    except (OSError, ValueError, RuntimeError) as error:  # Too long, a character no name has, links in a circle.
        raise CameraError(f"{where}: {field} names no file; correct it") from error


def _is_file(place: Path) -> bool:
    """Whether a file is there; unlike that of `Path`, raises where the name is none."""
    try:
        return stat.S_ISREG(place.stat().st_mode)
    except (FileNotFoundError, NotADirectoryError):
        return False


def _without_case(name: str, stem: str) -> str:
    """`name` with what follows `stem` in lower case."""
    return f"{stem}{name.removeprefix(stem).lower()}" if name.startswith(stem) else name


def _rigid(matrix: Any, where: str) -> Tensor:
    """(4, 4) float32 of a list of 4 (or 3) rows of 4 numbers that is a rotation and a translation."""
    try:
        c2w = torch.tensor(matrix, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        c2w = torch.zeros(0)
    if c2w.shape == (3, 4):
        c2w = torch.cat([c2w, torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)])
    if c2w.shape != (4, 4) or not bool((c2w.abs() <= LARGEST).all()):
        raise CameraError(f"{where}: transform_matrix is not 4 rows of 4 numbers; export the cameras again")
    rotation, last = c2w[:3, :3], torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64)
    skew = (rotation.T @ rotation - torch.eye(3, dtype=torch.float64)).abs().max()
    off = (c2w[3] - last).abs().max()
    if skew > _RIGID_TOLERANCE or torch.linalg.det(rotation) < 0.0 or off > _RIGID_TOLERANCE:
        raise CameraError(f"{where}: transform_matrix is not rigid; remove its scale or mirroring")
    c2w[3] = last
    return c2w.float()
