"""One capture through the command that a user would give, compared with what was photographed.

The program runs in a process of its own: its seconds and its memory are those of a user. The solved cameras' frame is
brought onto the true one by the cameras' centres alone; no surface is fitted to another.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from arm_blender import pipeline
from arm_blender.errors import ArmError
from arm_blender.photographs.solved import read_solved
from arm_blender.structures import TriangleMesh
from arm_blender.uv.mesh_file import read_mesh

from ..scores.alignment import moved_by, similarity_between
from ..scores.geometry import compare
from ..truth.captured import CapturedObject
from ..truth.objects import EvaluationObject
from ..truth.protocol import EvaluationEntry
from ..truth.truth import Appearance, Truth
from .asset_pictures import map_pictures
from .measure import SystemResult, score_pictures
from .trial import Trial

GOOD, WRONG = 0.01, 0.05
"""Error of a camera's centre, as a share of its distance from the object, up to which it is right, and from which on a
solution is wrong."""

SOLVED, DOUBTFUL, REFUSED = "solved", "doubtful", "refused"


@dataclass(frozen=True)
class CameraErrors:
    """How solved cameras lie, once their centres are brought onto the true ones.

    Attributes:
        motion: (4, 4) similarity from the solved frame to the true one.
        centers: of each picture the error of its centre, as a share of its distance from the object.
        angles: of each picture the error of its rotation, degrees.
    """

    motion: NDArray[np.float64]
    centers: dict[str, float]
    angles: dict[str, float]


@dataclass(frozen=True)
class Answer:
    """What the program made of a folder of photographs.

    Attributes:
        said: `SOLVED`, `DOUBTFUL` or `REFUSED`. words: why it doubts, or refuses.
        seconds: of the whole command. memory: the peak of the largest of its processes, MiB.
    """

    said: str
    words: str
    seconds: float
    memory: float


@dataclass(frozen=True)
class CaptureResult:
    """What was measured on one capture.

    Attributes:
        name: of the capture. spoilt: what is wrong with it on purpose.
        pictures: how many there are.
        answer: of the program.
        centers: as of `CameraErrors`, of the pictures that were registered.
        system: scores of the asset; None where there is none.
        posed: scores of the asset from six true views.
    """

    name: str
    spoilt: str | None
    pictures: int
    answer: Answer
    centers: dict[str, float] = field(default_factory=dict)
    system: SystemResult | None = None
    posed: SystemResult | None = None

    @property
    def good(self) -> int:
        """Pictures whose camera is right."""
        return sum(error < GOOD for error in self.centers.values())

    @property
    def wrong_in_silence(self) -> bool:
        """A wrong solution passed off as right."""
        errors = sorted(self.centers.values())
        return self.answer.said == SOLVED and bool(errors) and (errors[len(errors) // 2] > GOOD or errors[-1] > WRONG)


def camera_errors(solved: Mapping[str, NDArray[np.float64]], true: Mapping[str, NDArray[np.float64]]) -> CameraErrors:
    """Of the pictures (c2w by name) that both know; the true object stands at the origin.

    Raises:
        ArmError: they share fewer than three pictures.
    """
    names = sorted(solved.keys() & true.keys())
    if len(names) < 3:
        raise ArmError(f"{len(names)} of {len(true)} pictures have a camera; three are needed to compare them")
    found, aim = (np.stack([poses[name][:3, 3] for name in names]) for poses in (solved, true))
    motion = similarity_between(found, aim)
    scale = np.cbrt(np.linalg.det(motion[:3, :3]))
    off = np.linalg.norm(found @ motion[:3, :3].T + motion[:3, 3] - aim, axis=1) / np.linalg.norm(aim, axis=1)
    turns = [(motion[:3, :3] / scale) @ solved[n][:3, :3] @ true[n][:3, :3].T for n in names]
    angles = [np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))) for turn in turns]
    return CameraErrors(
        motion, dict(zip(names, off.tolist(), strict=True)), {n: float(a) for n, a in zip(names, angles, strict=True)}
    )


def answer(photographs: Path, output: Path, quality: str, *more: str) -> Answer:
    """Run the program on a folder of photographs, with `more` words."""
    command = [sys.executable, "-m", "arm_blender", "generate", str(photographs), "--output", str(output)]
    began = time.perf_counter()
    with tempfile.TemporaryFile("w+", errors="replace") as said:
        process = subprocess.Popen([*command, "--quality", quality, *more], stdout=subprocess.DEVNULL, stderr=said)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        lines = said.read().strip().splitlines() or ["no word"]
    cost = time.perf_counter() - began, usage.ru_maxrss / 1024
    if process.returncode != 0:
        return Answer(REFUSED, lines[-1].replace(str(photographs), photographs.name), *cost)
    doubts = json.loads((output / "report.json").read_text(encoding="utf-8"))["doubts"]
    return Answer(DOUBTFUL if doubts else SOLVED, "; ".join(doubts), *cost)


def measure_capture(
    capture: CapturedObject,
    entry: EvaluationEntry,
    item: EvaluationObject,
    truth: Truth,
    trial: Trial,
    output: Path,
) -> tuple[CaptureResult, Appearance | None]:
    """One capture, and what its asset shows from the truth's test views, lit by the truth's lights.

    Args:
        entry, item, truth: of the object that was photographed.
        output: folder of the asset.
    """
    from .asset_render_blender import file_appearance

    said = answer(capture.photographs, output, trial.settings.quality)
    result = CaptureResult(capture.name, capture.spoilt, len(capture.poses), said)
    if said.said == REFUSED:
        return result, None
    errors = camera_errors(read_solved(output / "views"), capture.poses)
    motion = torch.from_numpy(errors.motion).float()
    glb = next(output.glob("*.glb"))
    mesh = read_mesh(glb)
    shape = TriangleMesh(mesh.vertices, mesh.faces).moved(moved_by(motion))
    lights = truth.input_light, truth.other_light
    found = file_appearance(glb, motion, truth.tests.cameras, lights, trial.protocol)
    system = replace(
        score_pictures(found, truth.tests, entry, trial),
        geometry=compare(shape, capture.mesh(), trial.points, trial.seed),
    )
    asset, _ = pipeline.generate(item.views(), trial.settings)
    posed = score_pictures(map_pictures(asset, truth.tests.cameras), truth.tests, entry, trial)
    return replace(result, centers=errors.centers, system=system, posed=posed), found
