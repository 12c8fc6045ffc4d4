"""Simulated captures and their truth, as `python -m training render --layout capture` leaves them."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from arm_blender.errors import ArmError
from arm_blender.structures import TriangleMesh

from ...rendering.shards import read_mesh

TRUTH = "truth.json"


@dataclass(frozen=True)
class CapturedObject:
    """One capture.

    Attributes:
        name: of its folder. object: the id of what was photographed.
        folder: holds `images/`, `masks/` and the truth.
        spoilt: what is wrong with it on purpose; None where nothing is.
        poses: (4, 4) c2w (OpenGL axes) of every picture, by its name without suffix.
    """

    name: str
    object: str
    folder: Path
    spoilt: str | None
    poses: dict[str, NDArray[np.float64]]

    @property
    def photographs(self) -> Path:
        """The folder that a user would give."""
        return self.folder / "images"

    def mesh(self) -> TriangleMesh:
        """The true mesh in the frame of the true cameras; its longest side is 2."""
        return read_mesh(self.folder / "mesh.npz")


def captured_objects(folder: Path) -> list[CapturedObject]:
    """The whole captures in a folder, by their names.

    Raises:
        ArmError: there is none, or a truth is damaged.
    """
    found = []
    for path in sorted(folder.glob(f"*/{TRUTH}")):
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
            poses = {Path(one["file"]).stem: np.array(one["c2w"], np.float64) for one in record["pictures"]}
            captured = CapturedObject(path.parent.name, record["object"], path.parent, record["spoilt"], poses)
        except (ValueError, KeyError, TypeError) as error:
            raise ArmError(f"{path}: no whole truth ({error}); render the capture again") from error
        found.append(captured)
    if not found:
        raise ArmError(f"{folder}: no captures; make some with `python -m training render --layout capture`")
    return found
