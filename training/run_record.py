"""What a run leaves to look at: its configuration, numbers, pictures and TensorBoard events; a line on the terminal."""

import csv
import logging
import platform
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy
import torch
from PIL import Image
from torch import Tensor

from arm_blender.commands.progress_line import ProgressLine
from arm_blender.graphics.color import bytes_from_unit
from arm_blender.machine.files import check_output, whole_file, write_json
from arm_blender.version import VERSION

from . import distributed

if TYPE_CHECKING:  # It brings a package that need not be installed.
    from torch.utils.tensorboard import SummaryWriter

logger = logging.getLogger(__name__)

_COLUMNS = ("step", "kind", "name", "value")

SILENCE = 60.0
"""Seconds after which a line of the log says how far the run is, where no terminal shows it."""


class RunRecord:
    """Of one run, in a folder of its own.

    Args:
        folder: made where it is missing; None records nothing, and shows the line on a terminal only.
        arguments: of the run, for `config.json`.
    Raises:
        OutputError: the folder cannot be written.
    """

    def __init__(self, folder: Path | None, arguments: Mapping[str, Any] | None = None) -> None:
        self.folder = folder
        self._line = ProgressLine(sys.stderr) if sys.stderr.isatty() else None
        self._events: SummaryWriter | Literal[False] | None = None
        self._purge, self._said = 0, time.monotonic()
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            write_json(folder / "config.json", {"arguments": _plain(arguments or {}), "versions": versions()})

    @classmethod
    def beside(cls, output: Path, arguments: Mapping[str, Any]) -> "RunRecord":
        """In runs/NAME/ beside the output NAME.safetensors; of the first process alone.

        Raises:
            OutputError: the folder cannot be written.
        """
        check_output(output.parent)
        return cls(output.parent / "runs" / output.stem if distributed.rank() == 0 else None, arguments)

    def rewind(self, step: int) -> None:
        """Forget what came after a step: a resumed run makes it anew."""
        self._purge = step + 1
        if self.folder is None or not (self.folder / "scalars.csv").exists():
            return
        with open(self.folder / "scalars.csv", newline="", encoding="utf-8") as file:
            # A killed run may have left half of its last row.
            kept = [r for r in list(csv.reader(file))[1:] if len(r) == len(_COLUMNS) and int(r[0]) <= step]
        with whole_file(self.folder / "scalars.csv") as temporary, open(temporary, "w", newline="") as file:
            csv.writer(file).writerows([_COLUMNS, *kept])

    def scalars(self, step: int, kind: str, numbers: Mapping[str, float]) -> None:
        """Named numbers of a step: rows of `scalars.csv`, and TensorBoard's.

        Args:
            kind: "mean" over the last steps of training, or "validation".
        """
        if self.folder is None:
            return
        path = self.folder / "scalars.csv"
        new = not path.exists()
        with open(path, "a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerows([_COLUMNS] if new else [])
            writer.writerows([step, kind, name, repr(value)] for name, value in numbers.items())
        for name, value in numbers.items():
            if events := self._writer():
                events.add_scalar(f"{kind}/{name}", value, step)

    def picture(self, step: int, picture: Tensor) -> None:
        """(3, H, W) in [0, 1] as `validation.png`, which the next one replaces, and to TensorBoard, which keeps all."""
        if self.folder is None:
            return
        with whole_file(self.folder / "validation.png") as temporary:
            Image.fromarray(bytes_from_unit(picture.cpu()).permute(1, 2, 0).contiguous().numpy()).save(temporary)
        if events := self._writer():
            events.add_image("validation", picture, step)

    def show(self, fraction: float, message: str) -> None:
        """How far the run is: on a terminal always, else where the log has said nothing for a while."""
        if self._line is not None:
            self._line(fraction, message)
        elif self.folder is not None and time.monotonic() - self._said >= SILENCE:
            self.line("%.0f%%, %s", 100.0 * fraction, message)

    def line(self, text: str, *values: object) -> None:
        """A line of the log."""
        self._said = time.monotonic()
        if self._line is not None:
            self._line.clear()
        logger.info(text, *values)

    def close(self) -> None:
        """Nothing comes any more."""
        if self._line is not None:
            self._line.clear()
        if self._events:
            self._events.close()

    def _writer(self) -> "SummaryWriter | Literal[False]":
        """TensorBoard's, made when it is first needed; False where the package is not installed."""
        if self._events is None:
            try:
                from torch.utils.tensorboard import SummaryWriter
            except ImportError:
                logger.info("no TensorBoard events: `pip install tensorboard` brings them; scalars.csv has the numbers")
                self._events = False
            else:
                self._events = SummaryWriter(str(self.folder), purge_step=self._purge)
        return self._events


def last_scalar(output: Path, kind: str, name: str) -> float | None:
    """The latest number that the record beside an output holds; None where it holds none.

    Args:
        output: NAME.safetensors, as of `RunRecord.beside`.
        kind, name: as of `RunRecord.scalars`.
    """
    path = output.parent / "runs" / output.stem / "scalars.csv"
    if not path.is_file():
        return None
    with open(path, newline="", encoding="utf-8") as file:
        found = [row for row in csv.DictReader(file) if (row["kind"], row["name"]) == (kind, name)]
    return float(found[-1]["value"]) if found else None


def versions() -> dict[str, str]:
    """Of whatever the numbers of a run depend on."""
    return {
        "arm_blender": VERSION,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": numpy.__version__,
        "platform": platform.platform(),
    }


def _plain(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """As JSON has it."""
    known = (bool, int, float, str, type(None))
    return {name: value if isinstance(value, known) else str(value) for name, value in arguments.items()}
