"""The record beside clean views of every camera that is known, also of the pictures that became no view."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import CameraError
from ..machine.files import write_json
from .capture import Capture

SOLVED = "solved.json"
"""The file's name in a folder of clean views."""


def write_solved(capture: Capture, folder: Path) -> None:
    """Of every photograph its name and c2w, and of the others why they have none.

    Raises:
        OutputError: the file cannot be written.
    """
    cameras = {photograph.path.name: photograph.c2w.tolist() for photograph in capture.photographs}
    write_json(folder / SOLVED, {"cameras": cameras, "left_out": dict(capture.left_out)})


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
