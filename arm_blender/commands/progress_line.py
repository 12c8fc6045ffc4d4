"""How far a run is, in one line on stderr, and the seconds of its stages at the end."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from ..progress import Progress
from ..report import Report
from . import interrupts


class ProgressLine:
    """A `Progress` that rewrites one line on a terminal, and writes a line for each new message elsewhere."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream
        self.rewrites = stream.isatty()
        self.message = ""
        self.fraction = 0.0

    def __call__(self, fraction: float, message: str) -> None:
        if (fraction, message) == (self.fraction, self.message):
            return  # A network asks before each of its blocks whether to stop, and has nothing new to say.
        if self.rewrites:
            self.stream.write(f"\r\x1b[K{fraction:4.0%} {message}")
        elif message != self.message:
            self.stream.write(f"{fraction:4.0%} {message}\n")
        self.fraction, self.message = fraction, message
        self.stream.flush()

    def clear(self) -> None:
        """Takes the line off the terminal, so that what comes next starts on a clean one."""
        if self.rewrites and self.message:
            self.stream.write("\r\x1b[K")
            self.stream.flush()
        self.message = ""


@contextmanager
def shown(choice: str) -> Iterator[Progress]:
    """What --progress asks for: "always", "never", or "auto", which is on a terminal; the line is gone at the end.

    Each report is also where an interruption that went unheard is noticed.
    """
    hidden = choice == "never" or (choice == "auto" and not sys.stderr.isatty())
    line = None if hidden else ProgressLine(sys.stderr)

    def report(fraction: float, message: str) -> None:
        interrupts.check()
        if line is not None:
            line(fraction, message)

    try:
        yield report
    finally:
        if line is not None:
            line.clear()


def summary(report: Report) -> str:
    """The seconds of each stage, and what was left out, for reading."""
    data = report.as_dict()
    lines = [f"{name:<16} {seconds:7.2f} s" for name, seconds in data["seconds"].items()]
    lines.append(f"{'in all':<16} {data['total_seconds']:7.2f} s")
    if data["peak_memory_mib"] is not None:
        lines.append(f"{'peak memory':<16} {data['peak_memory_mib']:7.0f} MiB")
    lines += [f"left out: {note.what}: {note.why}" for note in report.left_out]
    return "\n".join(lines)
