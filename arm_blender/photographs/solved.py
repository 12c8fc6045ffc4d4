"""The record beside clean views of every camera that is known, also of the pictures that became no view."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ..errors import CameraError
from ..machine.files import write_json
from .capture import Capture, Lens, PosedPhotograph

SOLVED = "solved.json"
"""The file's name in a folder of clean views."""


def write_solved(capture: Capture, folder: Path, sharpness: Mapping[str, float] | None = None) -> None:
    """Of every photograph its name, c2w and lens, and of the others why they have none.

    Args:
        sharpness: of photographs by their names, beside that of their neighbours; kept for whoever asks.
    Raises:
        OutputError: the file cannot be written.
    """
    posed = capture.photographs
    data = {
        "cameras": {one.path.name: one.c2w.tolist() for one in posed},
        "lenses": {one.path.name: _written(one.lens) for one in posed},
        "mask_ways": {one.path.name: one.mask_way for one in posed},
        "points": capture.points.numpy().astype("<f4").tobytes().hex(),
        "ground": capture.ground,
        "sharpness": {name: round(value, 3) for name, value in (sharpness or {}).items()},
        "left_out": dict(capture.left_out),
    }
    write_json(folder / SOLVED, data)


def read_solved(folder: Path) -> Mapping[str, NDArray[np.float64]]:
    """(4, 4) c2w (OpenGL axes) of every photograph with a camera, by its name without suffix.

    Raises:
        CameraError: there is no such record, or it is damaged.
    """
    path = folder / SOLVED
    try:
        cameras = json.loads(path.read_text(encoding="utf-8"))["cameras"]
        poses = {Path(name).stem: np.array(c2w, np.float64) for name, c2w in cameras.items()}
        if any(pose.shape != (4, 4) for pose in poses.values()):
            raise ValueError("a pose is no matrix of 4 x 4")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CameraError(f"{path}: no record of solved cameras ({error}); solve them again") from error
    return poses


def solved_capture(folder: Path, paths: Sequence[Path], masks: Path) -> Capture:
    """The capture that `write_solved` wrote, of solved cameras.

    Args:
        folder: of the record.
        paths: of the photographs, where they are now.
        masks: folder of the masks that were found in them, as `mask_name` says; a photograph may have none.
    Raises:
        CameraError: there is no such record, it is damaged or of an earlier version, or a photograph is gone.
    """
    place = folder / SOLVED
    by_name = {path.name: path for path in paths}
    try:
        data = json.loads(place.read_text(encoding="utf-8"))
        points = np.frombuffer(bytes.fromhex(data["points"]), "<f4").reshape(-1, 3)
        ground = data["ground"]
        posed = []
        for name, c2w in data["cameras"].items():
            model, width, height, *parameters = data["lenses"][name]
            lens = Lens(str(model), tuple(float(value) for value in parameters), int(width), int(height))
            pose, mask = torch.tensor(c2w, dtype=torch.float64).reshape(4, 4), masks / mask_name(name)
            way = str(data["mask_ways"][name])
            posed.append(PosedPhotograph(by_name[name], pose, lens, mask if mask.is_file() else None, way))
        return Capture(
            tuple(posed),
            torch.tensor(points, dtype=torch.float64),
            dict(data["left_out"]),
            None if ground is None else float(ground),
            solved=True,
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError) as error:
        raise CameraError(f"{place}: no record of solved cameras ({error}); solve them again") from error


def _written(lens: Lens) -> list[str | float]:
    return [lens.model, lens.width, lens.height, *lens.parameters]


def mask_name(photograph: str) -> str:
    """Of the file that keeps the mask found in a photograph, by the photograph's name."""
    return f"{photograph}.png"
