"""One piece of work at a time behind the preferences: on a thread, watched by a timer, shown as a fraction and a line.

The preferences have no operator that could run as long as they are open, as a generation has.
"""

import logging
from collections.abc import Callable
from typing import Any

import bpy

from ...errors import Cancelled
from ...progress import Progress
from ..job import Job

logger = logging.getLogger(__name__)

_TICK = 0.2
"""Seconds between two looks at the job."""
_PATIENCE = 10.0
"""Seconds that disabling the extension waits for the thread."""

_job: Job[Any] | None = None
_done: Callable[[Any], None] | None = None
_fraction, _message, _error = 0.0, "", ""


def start(work: Callable[[Progress], Any], done: Callable[[Any], None]) -> None:
    """Run `work(progress)` on a thread, and then `done(result)` on Blender's own; without a window, at once.

    Raises:
        RuntimeError: other work is running.
    """
    global _job, _done, _fraction, _message, _error
    if _job is not None:
        raise RuntimeError("other work is running; wait for it, or stop it")
    _job, _done = Job(work), done
    _fraction, _message, _error = 0.0, "Starting", ""
    _job.start()
    if bpy.app.background:  # Timers never fire there.
        _job.join()
        _tick()
    else:
        bpy.app.timers.register(_tick, first_interval=_TICK, persistent=True)


def cancel() -> None:
    """Ask the work to stop; returns at once."""
    global _message
    if _job is not None:
        _job.cancel()
        _message = "Cancelling"


def progress() -> tuple[float, str] | None:
    """How far the running work is, and what it does; None where nothing runs."""
    return None if _job is None else (_fraction, _message)


def error() -> str:
    """What the last work failed of, in one line; empty where it did not."""
    return _error


def stop() -> None:
    """End the running work and forget it: its thread must not outlive the code that it runs."""
    global _job
    if _job is None:
        return
    _job.cancel()
    if not _job.join(_PATIENCE):
        logger.warning("the work of the preferences did not stop within %s s", _PATIENCE)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _job = None


def _tick() -> float | None:
    """Look at the job; the seconds until the next look, or None after its end."""
    global _job, _fraction, _message, _error
    job, done = _job, _done
    assert job is not None and done is not None  # `start` sets both, and without a job no timer runs.
    report = job.latest()
    if report is not None:
        _fraction, _message = report
    if job.finished:
        _job = None
        if job.failure is not None:
            logger.error("%s", job.failure)
            _error = f"Internal error: {job.failure.strip().splitlines()[-1]} (see the console)"
        elif job.error is not None:
            _error = "" if isinstance(job.error, Cancelled) else str(job.error)
        else:
            done(job.result)
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("PREFERENCES", "VIEW_3D"):
                area.tag_redraw()
    return _TICK if _job is not None else None
