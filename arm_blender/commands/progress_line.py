"""How far a run is: its stage, its share and the time left; and the seconds of its stages at the end."""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

from ..progress import Progress
from ..report import Report
from . import interrupts

UNSAID = 2.0
"""Seconds of a run that are too few to tell how long the rest takes; one that ends sooner need say nothing."""

AGAIN = 10.0
"""Seconds after which a line is written anew, off a terminal, though the stage is the same."""


class ProgressLine:
    """A `Progress` that rewrites one line on a terminal; elsewhere it writes one for each new message.

    Args:
        stream: is written to.
        quiet: seconds, off a terminal, in which nothing is written.
        clock: seconds that only grow.
    """

    def __init__(self, stream: TextIO, quiet: float = 0.0, clock: Callable[[], float] = time.monotonic) -> None:
        self.stream, self.quiet, self.clock = stream, quiet, clock
        self.rewrites = stream.isatty()
        self.message, self.fraction = "", 0.0
        self.written, self.written_at = "", 0.0
        self.began: tuple[float, float] | None = None  # When the first report came, and of what fraction.

    def __call__(self, fraction: float, message: str) -> None:
        now = self.clock()
        self.began = self.began or (now, fraction)
        if (fraction, message) == (self.fraction, self.message):
            return  # A network asks before each of its blocks whether to stop, and has nothing new to say.
        self.fraction, self.message = fraction, message
        text = f"{fraction:4.0%} {message}{rest_of(now - self.began[0], fraction, self.began[1])}"
        if self.rewrites:
            self.stream.write(f"\r\x1b[K{text}")
        elif now - self.began[0] >= self.quiet and (message != self.written or now - self.written_at >= AGAIN):
            self.stream.write(f"{text}\n")
            self.written, self.written_at = message, now
        self.stream.flush()

    def clear(self) -> None:
        """Takes the line off the terminal, so that what comes next starts on a clean one."""
        if self.rewrites and self.message:
            self.stream.write("\r\x1b[K")
            self.stream.flush()
        self.message = self.written = ""


class Counted:
    """Says of a list that is worked through how far it is, a line of the log for each item.

    Args:
        total: items.
        log: takes a line.
        clock: seconds that only grow.
    """

    def __init__(self, total: int, log: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self.total, self.log, self.clock = total, log, clock
        self.done, self.began = 0, clock()

    def __call__(self, what: str) -> None:
        """One more is done: "3 of 12, WHAT, about 4 min left"."""
        self.done += 1
        rest = rest_of(self.clock() - self.began, self.done / max(self.total, 1))
        self.log(f"{self.done} of {self.total}, {what}{rest}")

    def skip(self) -> None:
        """One needs no work, and tells nothing of the time that the others take."""
        self.total -= 1


def rest_of(seconds: float, fraction: float, begun_at: float = 0.0) -> str:
    """ ", about 4 min left", or nothing where there is too little to tell it by, or nothing left.

    Args:
        seconds: taken since the run, or what is left of one that goes on, was at `begun_at`.
        fraction: done; in [0, 1], as `begun_at`.
    """
    done = fraction - begun_at
    if seconds < UNSAID or done < 0.01 or fraction >= 1.0:
        return ""
    left = seconds * (1.0 - fraction) / done
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if left >= 2.0 * size:
            return f", about {left / size:.0f} {unit} left"
    return f", about {max(left, 1.0):.0f} s left"


def add_option(parser: argparse._ActionsContainer) -> None:
    """--progress, of every command that takes its time."""
    text = "lines on stderr: always, never, or (auto) at once on a terminal, else where a run takes over two seconds"
    parser.add_argument("--progress", choices=("auto", "always", "never"), default="auto", help=text)


@contextmanager
def shown(choice: str) -> Iterator[Progress]:
    """What --progress asks for; on a terminal the line is gone at the end.

    Each report is also where an interruption that went unheard is noticed.

    Args:
        choice: "always", "never", or "auto": on a terminal at once, elsewhere lines of a run that takes longer.
    """
    line = None if choice == "never" else ProgressLine(sys.stderr, UNSAID if choice == "auto" else 0.0)

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
