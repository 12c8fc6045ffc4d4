"""Damaged files of every format that is read: each has to end in a result or in one line that says what is wrong.

    python tools/fuzz.py [--cases N] [--minutes M] [--format NAME] [--seed N] [--write]

Good files are made (`damaged_files.py`), mutated (`mutations.py`), and read in processes of their own, where a crash, a
hang or too much memory takes nobody along. With --write the table goes to docs/robustness.md.
"""

import argparse
import faulthandler
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DOCUMENT = ROOT / "docs" / "robustness.md"
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

SECONDS = 20
"""That one file may take."""

MEMORY = 2 * 2**30
"""Bytes that reading one file may take, beyond what the program has."""

AT_ONCE = 250
"""Cases of one process: what leaks between them is seen, and Python's start hardly counts."""


@dataclass
class Found:
    """What became of the cases of one format.

    Attributes:
        outcomes: how often "result", "refused" or the name of a fault.
        slowest: seconds of one case.
        memory: bytes beyond what the program had, at most.
        faults: number of the case and what happened, of the first few.
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    memory: int = 0
    faults: list[tuple[int, str]] = field(default_factory=list)

    @property
    def fault_count(self) -> int:
        return sum(count for what, count in self.outcomes.items() if what not in ("result", "refused"))


def main() -> int:
    args = parse()
    if args.child:
        read_cases(args.child, args.seed, args.first, args.cases, Path(args.folder))
        return 0
    import damaged_files

    names = [args.format] if args.format else list(damaged_files.FORMATS)
    end = time.monotonic() + 60.0 * args.minutes
    found: dict[str, Found] = {}
    with tempfile.TemporaryDirectory(prefix="arm-fuzz-") as folder:
        for place, name in enumerate(names):
            share = (
                end - time.monotonic() if place == len(names) - 1 else (end - time.monotonic()) / (len(names) - place)
            )
            found[name] = fuzzed(name, args.seed, -(-args.cases // len(names)), time.monotonic() + share, Path(folder))
            print(row(name, found[name]), flush=True)
    text = table(found, args.seed)
    if args.write:
        write(text)
    print(text)
    return int(any(one.fault_count for one in found.values()))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=10_000, help="of all formats together")
    parser.add_argument("--minutes", type=float, default=60.0, help="after which no further case is begun")
    parser.add_argument("--format", help="only this one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", action="store_true", help=f"the table goes to {DOCUMENT.relative_to(ROOT)}")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--folder", help=argparse.SUPPRESS)
    return parser.parse_args()


def fuzzed(name: str, seed: int, cases: int, end: float, folder: Path) -> Found:
    """The cases of a format, in one process after another."""
    found, first = Found(), 0
    while first < cases and time.monotonic() < end:
        count = min(AT_ONCE, cases - first)
        words = ["--child", name, "--seed", seed, "--first", first, "--cases", count, "--folder", folder]
        command = [sys.executable, __file__, *map(str, words)]
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        done, begun = 0, time.monotonic()
        assert child.stdout is not None  # A pipe was asked for.
        for line in child.stdout:
            case = json.loads(line)
            done += 1
            found.outcomes[case["outcome"]] += 1
            found.slowest, found.memory = max(found.slowest, case["seconds"]), max(found.memory, case["memory"])
            if case["outcome"] not in ("result", "refused") and len(found.faults) < 5:
                found.faults.append((case["number"], case["outcome"]))
            if time.monotonic() > end:
                child.kill()
                break
        child.wait()
        if done < count and time.monotonic() < end:  # It died over the next one.
            outcome = f"ended by signal {-child.returncode}" if child.returncode < 0 else f"status {child.returncode}"
            found.outcomes[outcome] += 1
            found.faults.append((first + done, outcome))
            done += 1
            if done == 1 and time.monotonic() - begun < 1.0:
                raise SystemExit(f"{name}: its process does not start")
        first += done
    return found


def read_cases(name: str, seed: int, first: int, cases: int, folder: Path) -> None:
    """Reads mutated files, one line of JSON on stdout for each."""
    import damaged_files
    import mutations
    import torch

    from arm_blender.errors import ArmError

    torch.set_num_threads(1)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    faulthandler.enable()
    signal.signal(signal.SIGALRM, too_long)
    one = damaged_files.FORMATS[name]
    good = one.make(folder)
    for content in good:  # What libraries load counts for none of the cases.
        one.read(content, folder)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    limited()
    for number in range(first, first + cases):
        generator = random.Random(f"{seed} {name} {number}")
        content = mutations.mutated(generator.choice(good), generator)
        start, outcome = time.monotonic(), "result"
        signal.alarm(SECONDS)
        try:
            one.read(content, folder)
        except ArmError as error:
            outcome = "refused" if len(str(error).splitlines()) == 1 else "more than a line"
        except Exception as error:  # noqa: BLE001  Each of them is what we look for.
            outcome = type(error).__name__
        signal.alarm(0)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        answer = {"number": number, "outcome": outcome, "seconds": round(time.monotonic() - start, 2)}
        answers.write(json.dumps(answer | {"memory": 1024 * (peak - before)}) + "\n")
        answers.flush()


def limited() -> None:
    """No more address space than now, and what a case may take: then allocations fail."""
    used = next(int(line.split()[1]) * 1024 for line in Path("/proc/self/status").open() if line.startswith("VmSize"))
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))


def too_long(*_: Any) -> None:
    raise TimeoutError(f"more than {SECONDS} s")


HEAD = "| format | cases | read | refused in a line | faults | slowest | memory |\n| --- " + 6 * "| ---: " + "|"


def row(name: str, one: Found) -> str:
    kinds = ", ".join(f"{what} {count}" for what, count in one.outcomes.items() if what not in ("result", "refused"))
    faults = f"{one.fault_count} ({kinds})" if kinds else "0"
    numbers = [sum(one.outcomes.values()), one.outcomes["result"], one.outcomes["refused"], faults]
    return f"| {name} | {' | '.join(map(str, numbers))} | {one.slowest:.1f} s | {one.memory / 2**20:.0f} MiB |"


def table(found: dict[str, Found], seed: int) -> str:
    total = sum(sum(one.outcomes.values()) for one in found.values())
    faults = sum(one.fault_count for one in found.values())
    lines = [HEAD, *(row(name, one) for name, one in found.items()), ""]
    lines += [
        f"{total:,} files, {faults} faults. Made by `make fuzz` (seed {seed}); the number of a case makes it anew."
    ]
    lines += [f"- {name}, case {number}: {what}" for name, one in found.items() for number, what in one.faults]
    return "\n".join(lines)


def write(text: str) -> None:
    """Puts the table into the document."""
    from training.documents import fill_block

    fill_block(DOCUMENT, "fuzz", text)


if __name__ == "__main__":
    sys.exit(main())
