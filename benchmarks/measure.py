"""What the benchmarks share: seconds of a call, peak memory of a process, and the machine in words."""

import argparse
import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch

from arm_blender.report import own_peak_mib


@dataclass(frozen=True)
class Section:
    """What one benchmark found.

    Attributes:
        text: Markdown, with its own heading.
        highlights: what was measured, and the result, in words.
        curves: named series of points (x, y), for the plot.
    """

    text: str
    highlights: list[tuple[str, str]]
    curves: dict[str, list[tuple[float, float]]] = field(default_factory=dict)


def median_seconds(call: Callable[[], object], repeats: int = 5) -> float:
    """The median of `repeats` calls, after one that is not counted: it also pays for torch's start."""
    call()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def seconds_of(call: Callable[[], object]) -> float:
    """Of one call, where several would take too long."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def cpu_seconds() -> float:
    """Of this process and of its ended children so far, all cores together: what other work on the machine does not
    change."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


class PeakMemory:
    """The highest resident size of this process since the last `reset`, or since its start where none can be made."""

    def reset(self) -> None:
        """Count anew from here; Linux alone can."""
        place = Path("/proc/self/clear_refs")
        if place.exists():
            place.write_text("5")

    def gib(self) -> float:
        """Files that are mapped count where they have been read."""
        return own_peak_mib() / 2**10


def machine() -> str:
    """Processor, cores, threads and versions."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor() or platform.machine()
    return (
        f"{processor}, {os.cpu_count()} cores, {torch.get_num_threads()} threads; {platform.system()}, "
        f"Python {platform.python_version()}, torch {torch.__version__}"
    )


def run(section: Callable[[], Section], description: str) -> None:
    """The command line of one benchmark: print what it found."""
    parser = argparse.ArgumentParser(description=description.partition("\n")[0])
    parser.add_argument("--threads", type=int, default=2, help="of torch (default 2)")
    torch.set_num_threads(parser.parse_args().threads)
    print(section().text)
