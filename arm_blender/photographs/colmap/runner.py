"""Starts pycolmap's own process with a job, waits for it so that a stop is heard, and reads what it told and made."""

import json
import logging
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any

import numpy as np

from ...errors import ArmError
from ...machine.libraries import is_there
from ...machine.memory import limit_child
from ...progress import Progress
from .process import MARK

logger = logging.getLogger(__name__)

PROGRAM = Path(__file__).with_name("process.py")

NOT_THERE = "pycolmap is not installed: pip install pycolmap, or the preferences' Install inside Blender"

_TICK = 0.2
"""Seconds until a stop is noticed."""


class ColmapFailed(ArmError):
    """pycolmap ended without a result; `reason` says why."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"pycolmap failed ({reason}); give other pictures, or do this step by another program")
        self.reason = reason


def run(
    step: str, job: dict[str, Any], folder: Path, progress: Progress, message: str, threads: int | None = None
) -> list[dict[str, Any]]:
    """Runs a step of `process` to its end; what it told.

    Args:
        step: name of a function of `process.STEPS`.
        job: what the function wants, as JSON types.
        folder: for the job and what goes wrong; exists.
        progress: told `message` until the process tells something else; what it raises ends the process.
        threads: of the libraries beneath; None leaves it to them.
    Raises:
        ArmError: pycolmap is not there.
        ColmapFailed: the process ended without a result.
    """
    if not is_there("pycolmap"):
        raise ArmError(NOT_THERE)
    task, log = folder / f"{step}.json", folder / f"{step}.log"
    task.write_text(json.dumps(job | {"step": step}), encoding="utf-8")
    command = [sys.executable, "-I", str(PROGRAM), str(task), os.pathsep.join(path for path in sys.path if path)]
    environment = dict(os.environ) if threads is None else os.environ | {"OMP_NUM_THREADS": str(threads)}
    with log.open("wb") as errors:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=environment,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # No console window on Windows.
        )
        assert process.stdout is not None  # A pipe was asked for.
        limit_child(process.pid)
        lines: SimpleQueue[dict[str, Any]] = SimpleQueue()
        reader = threading.Thread(target=_listen, args=(process.stdout, lines), daemon=True)
        reader.start()
        try:
            said = list(_heard(reader, lines, progress, message))
        finally:
            process.kill()
            process.wait()
            reader.join()
            process.stdout.close()
    if process.returncode != 0:
        logger.debug("%s", log.read_text(encoding="utf-8", errors="replace"))
        reasons = [line["error"] for line in said if "error" in line]
        raise ColmapFailed(reasons[-1] if reasons else f"it ended with status {process.returncode}")
    return said


def arrays(step: str, job: dict[str, Any], progress: Progress, message: str) -> dict[str, Any]:
    """The arrays that a step makes, by their names.

    Args: and Raises: as `run`; the job is told where to write them, as `out`.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out.npz")
        run(step, job | {"out": str(out)}, Path(folder), progress, message)
        with np.load(out) as made:
            return {name: made[name] for name in made.files}


def _listen(stream: IO[bytes], lines: "SimpleQueue[dict[str, Any]]") -> None:
    """Takes what is meant for us out of what native code prints."""
    for line in stream:
        text = line.decode("utf-8", "replace")
        if text.startswith(MARK):
            lines.put(json.loads(text.removeprefix(MARK)))


def _heard(
    reader: threading.Thread, lines: "SimpleQueue[dict[str, Any]]", progress: Progress, message: str
) -> Iterator[dict[str, Any]]:
    """What the process tells, until it ends; `progress` hears of it, and is asked whether to go on."""
    fraction = 0.0
    while reader.is_alive() or not lines.empty():
        progress(fraction, message)
        try:
            line = lines.get(timeout=_TICK)
        except Empty:
            continue
        if "fraction" in line:
            fraction, message = line["fraction"], line["message"]
        yield line
