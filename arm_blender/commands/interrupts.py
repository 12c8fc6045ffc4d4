"""Ctrl-C, a polite kill, a closed terminal: each ends the run as `KeyboardInterrupt`, and none is lost.

An exception that a signal raises while C code imports a module can vanish there. So the signal is also remembered, and
the next report of progress raises it again.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_asked = threading.Event()


def watched() -> list[int]:
    """The signals to listen to; not those that this process was started to ignore, as nohup does with SIGHUP."""
    there = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    return [number for number in there if signal.getsignal(number) is not signal.SIG_IGN]


def watch(numbers: list[int], idle: bool = False) -> None:
    """Listens to the signals `numbers`, on the main thread of a process.

    Args:
        numbers: as `watched` gives them.
        idle: nothing is underway that could be left half-done: the signal is remembered, and raises nothing.
    """
    for number in numbers:
        signal.signal(number, _remember if idle else _interrupt)


@contextmanager
def listening() -> Iterator[None]:
    """Listens during the block, on the main thread of a process that has other uses for its signals afterwards."""
    before = {number: signal.getsignal(number) for number in watched()}
    watch(list(before))
    try:
        yield
    finally:
        _asked.clear()
        for number, handler in before.items():
            if handler is not None:  # None: one of C, which Python can neither name nor bring back.
                signal.signal(number, handler)


def ask() -> None:
    """As if a signal had come: the next `check` raises."""
    _asked.set()


def check() -> None:
    """Raises `KeyboardInterrupt` where a signal has come since the process began."""
    if _asked.is_set():
        raise KeyboardInterrupt


def _remember(number: int, frame: FrameType | None) -> None:
    _asked.set()


def _interrupt(number: int, frame: FrameType | None) -> None:
    _asked.set()
    raise KeyboardInterrupt
