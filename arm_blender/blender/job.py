"""Work on a thread of its own, watched from Blender's main thread. No bpy in this module, and none in the work."""

import threading
import time
import traceback
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

from ..errors import ArmError, Cancelled
from ..progress import Progress

Result = TypeVar("Result")


class Job(Generic[Result]):
    """One run of `work(progress)` on a thread.

    `work` reports through the callback that it is given; after `cancel` that callback raises `Cancelled`, so a job
    stops at its next report. The attributes are final once `finished` is true.

    Attributes:
        result: what `work` returned; None before the end and after a failure.
        error: the `ArmError` that ended the work (`Cancelled` where the user stopped it), else None.
        failure: the traceback of any other exception, as text, else None: a bug.
    """

    def __init__(self, work: Callable[[Progress], Result]) -> None:
        self.result: Result | None = None
        self.error: ArmError | None = None
        self.failure: str | None = None
        self._work = work
        self._reports: SimpleQueue[tuple[float, str]] = SimpleQueue()
        self._cancelled = threading.Event()
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="arm-job", daemon=True)

    def start(self) -> "Job[Result]":
        self._began = time.monotonic()
        self._thread.start()
        return self

    def cancel(self) -> None:
        """Ask the work to stop; returns at once."""
        self._cancelled.set()

    @property
    def cancelled(self) -> bool:
        """The work was asked to stop."""
        return self._cancelled.is_set()

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._began

    def join(self, seconds: float | None = None) -> bool:
        """Wait for the end, at most `seconds`; True if the work has ended."""
        self._thread.join(seconds)
        return self.finished

    @property
    def finished(self) -> bool:
        """The work was started and has ended, in whichever way."""
        return self._thread.ident is not None and not self._thread.is_alive()

    def latest(self) -> tuple[float, str] | None:
        """The newest report since the last call, if there is one: a fraction in [0, 1] and what is being done."""
        report = None
        while True:
            try:
                report = self._reports.get_nowait()
            except Empty:
                return report

    def _progress(self, fraction: float, message: str) -> None:
        if self._cancelled.is_set():
            raise Cancelled("stopped by the user")
        self._reports.put((fraction, message))

    def _run(self) -> None:
        try:
            self.result = self._work(self._progress)
        except ArmError as error:
            self.error = error
        except Exception:  # A thread has no caller: whoever watches it shows the traceback.
            self.failure = traceback.format_exc()
