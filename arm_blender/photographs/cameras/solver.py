"""Asks the process that solves cameras for one step after the other, and reads what it found."""

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import CameraError
from ...progress import Progress
from ..capture import Lens
from ..colmap.runner import ColmapFailed, run


@dataclass(frozen=True)
class Solution:
    """Cameras that fit the matches, in a frame of their own.

    Attributes:
        names: of the V pictures that have a camera.
        w2c: (V, 4, 4) float64, world to camera, OpenCV axes: the camera looks along +Z, +Y is down.
        lenses: of the pictures.
        points: (P, 3) float64, world.
        seen: (O, 4) float64: picture, point, and x and y of the pixel where it was seen.
        pairs: (Q, 4) float64: two pictures, their matches, and how many of those the cameras allow.
        error: pixels between the points and where they were seen, the mean.
    """

    names: tuple[str, ...]
    w2c: Tensor
    lenses: tuple[Lens, ...]
    points: Tensor
    seen: Tensor
    pairs: Tensor
    error: float

    @property
    def centers(self) -> Tensor:
        """(V, 3) of the cameras."""
        return -(self.w2c[:, :3, :3].transpose(1, 2) @ self.w2c[:, :3, 3:])[..., 0]


@dataclass(frozen=True)
class Job:
    """What the process works on.

    Attributes:
        folder: for its files; exists.
        pictures: a folder of small upright copies, numbered.
        masks: a folder of masks, NAME.png of the picture NAME; None looks everywhere.
        lenses: as the process wants them: width, height, focal length in pixels or None, names of pictures.
        threads: of the CPU.
        seed: of whatever is drawn.
    """

    folder: Path
    pictures: Path
    masks: Path | None
    lenses: list[dict[str, Any]]
    threads: int
    seed: int

    @property
    def focal_is_known(self) -> bool:
        return all(lens["focal"] for lens in self.lenses)

    def words(self, **more: Any) -> dict[str, Any]:
        """For the process, as JSON types."""
        known: dict[str, Any] = {"database": str(self.folder / "matches.db"), "pictures": str(self.pictures)}
        known |= {"masks": str(self.masks) if self.masks else "", "lenses": self.lenses, "threads": self.threads}
        return known | {"seed": self.seed, "count": sum(len(lens["pictures"]) for lens in self.lenses)} | more


def match(job: Job, progress: Progress) -> None:
    """Finds features in all pictures, and the same ones in any two.

    Raises:
        ArmError: pycolmap is not there, or its process has failed.
    """
    _run("match", job, job.words(), progress)


def solve(job: Job, name: str, factor: float | None, progress: Progress) -> tuple[list[Solution], list[list[str]]]:
    """Cameras from the matches.

    Args:
        name: of the attempt, as a folder.
        factor: focal lengths that are not known, as shares of the longer side.
    Returns:
        The largest solution, with its lenses held and, where that gave any, set free; and the names of the pictures of
        each solution, largest first: pictures of two things end in two. Both are empty where nothing was solved.
    Raises:
        ArmError: as `match`.
    """
    models = job.folder / name
    said = _run("map_pictures", job, job.words(factor=factor, models=str(models), refine=True), progress)
    groups: list[list[str]] = next((words["models"] for words in said if "models" in words), [])
    return [_read(models / kind) for kind in ("fixed", "refined") if (models / f"{kind}.npz").is_file()], groups


def solve_again(job: Job, first: Solution, progress: Progress) -> Solution | None:
    """A second opinion: from the same matches by another way, all cameras at once; None where it finds none.

    Raises:
        ArmError: as `match`.
    """
    solved = [
        {"picture": name, "parameters": lens.parameters} for name, lens in zip(first.names, first.lenses, strict=True)
    ]
    models = job.folder / "again"
    _run("map_again", job, job.words(solved=solved, models=str(models)), progress)
    return _read(models / "again") if (models / "again.npz").is_file() else None


def _read(stem: Path) -> Solution:
    """What the process wrote of one model.

    Raises:
        CameraError: it is no model.
    """
    try:
        return _read_whole(stem)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise _broken(str(error)) from error


def _read_whole(stem: Path) -> Solution:
    told = json.loads(stem.with_suffix(".json").read_text(encoding="utf-8"))
    with np.load(stem.with_suffix(".npz")) as arrays:
        points, seen, pairs = (torch.from_numpy(arrays[name]) for name in ("points", "seen", "pairs"))
    rows = torch.tensor([picture["world_to_camera"] for picture in told["pictures"]], dtype=torch.float64)
    w2c = torch.cat([rows, rows.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(rows), 1, 4)], dim=1)
    lenses = (
        Lens(picture["model"], tuple(picture["parameters"]), picture["width"], picture["height"])
        for picture in told["pictures"]
    )
    names = tuple(picture["name"] for picture in told["pictures"])
    return Solution(names, w2c, tuple(lenses), points, seen, pairs, told["error"])


def _run(step: str, job: Job, words: dict[str, Any], progress: Progress) -> list[dict[str, Any]]:
    """Runs a step of the process to its end; what it told.

    Raises:
        ArmError: pycolmap is not there, failed, or crashed.
    """
    try:
        return run(step, words, job.folder, progress, "starting pycolmap", job.threads)
    except ColmapFailed as failed:
        raise _broken(failed.reason) from failed


def _broken(reason: str) -> CameraError:
    return CameraError(f"pycolmap failed ({reason}); try fewer pictures, or solve the cameras by another program")
