"""Starts pycolmap's own process with a job, waits for it so that a stop is heard, and reads what it made."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ArmError
from ..machine.libraries import is_there
from ..progress import Progress

NOT_THERE = "pycolmap is not installed; `pip install pycolmap`, or undistort the pictures by another program"

_TICK = 0.2
"""Seconds until a stop is noticed."""


class ColmapFailed(ArmError):
    """pycolmap ended without a result; its last line says why."""


def run_job(job: dict[str, Any], progress: Progress, message: str) -> dict[str, Any]:
    """The arrays that a job of `colmap_process` made, by their names.

    Args:
        job: as its function there wants it, without `out`.
        progress: told `message` while the process runs; what it raises ends the process.
    Raises:
        ArmError: pycolmap is not there.
        ColmapFailed: the process ended without a result.
    """
    if not is_there("pycolmap"):
        raise ArmError(NOT_THERE)
    program = Path(__file__).with_name("colmap_process.py")
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path), PYTHONUTF8="1")
    with tempfile.TemporaryDirectory() as folder:
        out, log, task = Path(folder, "out.npz"), Path(folder, "log.txt"), Path(folder, "job.json")
        task.write_text(json.dumps(job | {"out": str(out)}), encoding="utf-8")
        with log.open("wb") as errors, task.open("rb") as given:
            # -P: the modules beside the program are no libraries.
            process = subprocess.Popen(
                [sys.executable, "-P", str(program)], stdin=given, stdout=errors, stderr=errors, env=environment
            )
            try:
                while _runs(process):
                    progress(0.0, message)
            finally:
                process.kill()
                process.wait()
        if process.returncode != 0 or not out.is_file():
            raise ColmapFailed(f"pycolmap failed: {_last_line(log, process.returncode)}")
        with np.load(out) as arrays:
            return {name: arrays[name] for name in arrays.files}


def _runs(process: "subprocess.Popen[bytes]") -> bool:
    """Whether a process still runs after a moment."""
    try:
        process.wait(_TICK)
    except subprocess.TimeoutExpired:
        return True
    return False


def _last_line(log: Path, status: int) -> str:
    lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    return lines[-1][:200] if lines else f"it ended with status {status}"
