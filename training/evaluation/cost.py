"""What a user pays: seconds of the program from its start, seconds of one more object, and MiB of weights."""

import logging
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from arm_blender import pipeline
from arm_blender.errors import ArmError
from arm_blender.views import load_views

from .tables.bars import Cost
from .trials.trial import Trial

logger = logging.getLogger(__name__)

UNKNOWN = float("nan")


def measured_cost(views: Path, trial: Trial) -> Cost:
    """The cost on one object; a time that cannot be taken is NaN.

    Args:
        views: folder of its six views.
    """
    settings = trial.settings
    size = sum(settings.weights(name).stat().st_size for name in settings.networks)
    return Cost(_cold(views, trial), _warm(views, trial), size / 2**20)


def _cold(views: Path, trial: Trial) -> float:
    """Seconds of `generate`, a process of its own, from its start to its last file."""
    settings = trial.settings
    with tempfile.TemporaryDirectory() as folder:
        words = [str(views), "--output", folder, "--preset", settings.preset, "--quality", settings.quality]
        own = {"weights": settings.weights_folder}
        own |= {name: getattr(settings, name) for name in ("grid", "faces", "refinement")}
        for name, value in own.items():
            words += [] if value is None else [f"--{name}", str(value)]
        start = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "arm_blender", "generate", *words, "--device", settings.device],
            capture_output=True,
            text=True,
            check=False,
        )
        seconds = time.perf_counter() - start
    if done.returncode != 0:
        logger.warning("%s: not timed: %s", views, done.stderr.strip().rpartition("\n")[2])
        return UNKNOWN
    return seconds


def _warm(views: Path, trial: Trial) -> float:
    """Seconds from the files of the views to the asset, once everything has been loaded."""
    try:
        pipeline.generate(load_views(views), trial.settings)
        start = time.perf_counter()
        pipeline.generate(load_views(views), trial.settings)
    except ArmError as error:
        logger.warning("%s: not timed: %s", views, error)
        return UNKNOWN
    return time.perf_counter() - start
