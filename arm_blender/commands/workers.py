"""Processes side by side that make the items of a batch: each is asked for one at a time, and its end is noticed.

A worker is this package in a process of its own, started by its folder: as an extension of Blender the package has a
name that no other process could import. Requests go to its standard input, pickled; a line of JSON comes back for each.
"""

from __future__ import annotations

import json
import logging
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Generator, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from . import interrupts

PATIENCE = 10.0
"""Seconds that a worker gets to clear up after it was told to stop."""

logger = logging.getLogger(__name__)

_MARK = "\x1earm "
"""Begins each answer: Blender writes lines of its own before we can stop it."""

_START = (
    "import sys; sys.path[:] = {path!r}; from {package}.commands.workers import serve; serve({module!r}, {words!r})"
)

Answer = dict[str, Any] | None
"""What a worker made of an item; None where its process died over it."""

Ended = tuple[Any, Answer] | BaseException
"""An item with the answer to it, or what ended a foreman."""


def side_by_side(
    items: Sequence[Any], jobs: int, module: str, words: dict[str, Any]
) -> Generator[tuple[Any, Answer], None, None]:
    """Each item with the answer to it, in the order in which they end.

    A worker that dies takes only its own item with it; another takes its place. Closing the generator stops them all.

    Args:
        items: to be pickled; of classes that are not ours.
        jobs: how many processes at most; they share the machine's cores.
        module: its `answer(item, words)` runs in the workers and gives JSON; named as if
            `arm_blender` were on the path.
        words: the same for all items; pickled as well.
    """
    waiting: SimpleQueue[Any] = SimpleQueue()
    for item in items:
        waiting.put(item)
    ended: SimpleQueue[Ended] = SimpleQueue()
    count = min(jobs, len(items))
    crew = [_Foreman(waiting, ended, command(module, words), threads_of_each(count)) for _ in range(count)]
    try:
        for foreman in crew:
            foreman.start()
        for _ in items:
            found = ended.get()
            if isinstance(found, BaseException):
                raise found
            yield found
    finally:
        for foreman in crew:
            foreman.stop()
        for foreman in crew:
            foreman.join(PATIENCE)
            foreman.kill()


def threads_of_each(processes: int) -> int:
    """How many threads a process may take so that all of them together have one for each core that is ours."""
    ours = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, ours // processes)


class _Foreman(threading.Thread):
    """Hands items to one worker after another, and waits for each answer."""

    def __init__(self, waiting: SimpleQueue[Any], ended: SimpleQueue[Ended], command: list[str], threads: int) -> None:
        super().__init__(daemon=True)
        self._waiting, self._ended, self._command = waiting, ended, command
        self._environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
        self._worker: subprocess.Popen[bytes] | None = None
        self._stopped = False
        self._hiring = threading.Lock()

    def run(self) -> None:
        try:
            while not self._stopped:
                item = self._waiting.get_nowait()
                self._ended.put((item, self._answer(item)))
        except Empty:
            pass
        except BaseException as error:  # noqa: BLE001  A thread has no caller: whoever waits for the answers raises it.
            self._ended.put(error)
        finally:
            if self._worker is not None:
                assert self._worker.stdin is not None  # `_answer` gives it one.
                with suppress(OSError):
                    self._worker.stdin.close()  # The end of its input: an idle worker leaves.
                self._worker.wait()

    def stop(self) -> None:
        """No further item; the worker is told to leave the one that it has. Returns at once."""
        with self._hiring:
            self._stopped = True
            if self._worker is not None and self._worker.poll() is None:
                self._worker.terminate()

    def kill(self) -> None:
        """The worker is gone, whatever it was doing."""
        if self._worker is not None and self._worker.poll() is None:
            self._worker.kill()

    def _answer(self, item: Any) -> Answer:
        with self._hiring:
            if self._stopped:
                return None
            if self._worker is None or self._worker.poll() is not None:
                # In a group of its own: a key that interrupts comes to us alone, and we tell it.
                self._worker = subprocess.Popen(
                    self._command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    env=self._environment,
                    start_new_session=True,
                    creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
                )
        requests, answers = self._worker.stdin, self._worker.stdout
        assert requests is not None and answers is not None  # Both are pipes.
        try:
            pickle.dump(item, requests)
            requests.flush()
            for line in answers:
                text = line.decode("utf-8", "replace")
                if text.startswith(_MARK):
                    return json.loads(text.removeprefix(_MARK))
        except OSError:  # A broken pipe: the worker has died.
            logger.debug("worker %s is gone", self._worker.pid)
        self._worker.wait()
        return None


def command(module: str, words: dict[str, Any]) -> list[str]:
    """What starts a worker: Blender itself where we run inside it, for only there is bpy, else Python."""
    package = Path(__file__).resolve().parents[1]
    path = [str(package.parent), *search_path()]
    code = _START.format(path=path, package=package.name, module=module, words=pickle.dumps(words))
    blender = getattr(getattr(sys.modules.get("bpy"), "app", None), "binary_path", "")
    if blender:
        return [blender, "--background", "--factory-startup", "--python-exit-code", "1", "--python-expr", code]
    return [sys.executable, "-c", code]


def search_path() -> list[str]:
    """Where a new process of the same program finds what this one can import.

    Where Python imported Blender, not the other way round, without the folders of scripts that this added: with them in
    front, `import bpy` finds the half of it that only works once the other half runs.
    """
    bpy = sys.modules.get("bpy")
    if bpy is None or bpy.app.binary_path:
        return list(sys.path)
    scripts = Path(bpy.utils.resource_path("LOCAL"), "scripts")
    return [place for place in sys.path if not Path(place).is_relative_to(scripts)]


def serve(module: str, words: bytes) -> None:
    """A worker's life: answers what comes in until the input ends, or the process that asks is gone."""
    import importlib

    signals = interrupts.watched()
    interrupts.watch(signals, idle=True)
    # What libraries and Blender print goes to the errors; the answers have the output for themselves.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    answer = importlib.import_module(module).answer
    known = pickle.loads(words)
    requests: SimpleQueue[Any] = SimpleQueue()
    threading.Thread(target=_listen, args=(requests,), daemon=True).start()
    while (item := requests.get()) is not None:
        interrupts.watch(signals)
        try:
            interrupts.check()
            found = answer(item[0], known)
        except KeyboardInterrupt:
            return
        finally:
            interrupts.watch(signals, idle=True)
        answers.write(_MARK + json.dumps(found) + "\n")
        answers.flush()


def _listen(requests: SimpleQueue[Any]) -> None:
    """Reads requests ahead of the work, so that the end of the input is noticed during the work."""
    # Not `sys.stdin`: while a thread waits for it, Python cannot end in peace.
    source = os.fdopen(os.dup(0), "rb")
    try:
        while True:
            requests.put((pickle.load(source),))
    except (EOFError, OSError, pickle.UnpicklingError):
        interrupts.ask()  # Nobody waits for the item that is underway: its next report stops it.
        requests.put(None)
