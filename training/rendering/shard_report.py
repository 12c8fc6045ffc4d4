"""`python -m training shards`: what shards hold, what was left out and why, whether they are whole, what more costs."""

import argparse
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from arm_blender.errors import ArmError

from ..documents import fill_block, markdown_table
from . import shard_writer
from .shards import read_index, read_indexes


@dataclass(frozen=True)
class Cost:
    """What rendering took, by the index of what was rendered.

    Attributes:
        view: seconds of one object-view: one pass of Cycles, written and read.
        overhead: seconds an object beside that: import, selection, compression; those left out cost it, too.
        yielded: of the objects tried, the share that was rendered.
        size: bytes an object.
    """

    view: float
    overhead: float
    yielded: float
    size: float

    def days(self, objects: int, views: int, machines: int) -> float:
        """Days that `machines` such as the measured one need for `objects` rendered objects of `views` views."""
        return objects * (views * self.view + self.overhead / self.yielded) / machines / 86_400.0


def measured_cost(indexes: list[dict[str, Any]]) -> Cost:
    """The mean over all objects of these indexes.

    Raises:
        ArmError: no object was rendered.
    """
    records = [record for index in indexes for record in index["objects"]]
    rendered = [record for record in records if not record.get("dropped")]
    if not rendered:
        raise ArmError("no rendered object to measure; render some with `python -m training render`")
    rendering = sum(record["seconds"]["rendering"] for record in rendered)
    views = sum(record["views"] * len(record["lightings"]) for record in rendered)
    # One that was tried twice, and died, has no seconds.
    everything = sum(record["seconds"].get("all", 0.0) for record in records)
    return Cost(
        view=rendering / views,
        overhead=(everything - rendering) / len(records),
        yielded=len(rendered) / len(records),
        size=sum(index.get("bytes", 0) for index in indexes) / len(rendered),
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training shards`."""
    parser.add_argument("shards", type=Path, help="folder that `python -m training render` has written")
    parser.add_argument("--verify", action="store_true", help="compare every shard with its SHA-256")
    parser.add_argument("--objects", type=int, default=150_000, help="of the data set whose cost is told")
    parser.add_argument("--views", type=int, default=32, help="views an object of that data set")
    parser.add_argument("--machines", type=int, nargs="+", default=(1, 8, 64, 256), help="that would render it")
    parser.add_argument("--update", type=Path, help="a document whose block `cost` is filled")


def run(args: argparse.Namespace) -> int:
    """Print the report; 1 where a shard is damaged."""
    indexes = read_indexes(args.shards)
    if not indexes:
        raise ArmError(f"{args.shards}: no finished shard; make some with `python -m training render`")
    records = [record for index in indexes for record in index["objects"]]
    dropped = Counter(_kind(record["dropped"]) for record in records if record.get("dropped"))
    shards = sum(index["shard"] is not None for index in indexes)
    print(f"{len(records) - dropped.total()} of {len(records)} objects in {shards} shards")
    for reason, count in dropped.most_common():
        print(f"left out {count}: {reason}")
    wrong = shard_writer.verify(args.shards) if args.verify else []
    for name in wrong:
        print(f"{args.shards / name}: damaged or missing; remove it with its .json, and render again")
    if args.verify and not wrong:
        print("all shards are what their index says")
    text = cost_table(measured_cost(indexes), read_index(args.shards / "index.json")["settings"], args)
    print(text)
    if args.update:
        fill_block(args.update, "cost", text)
    return 1 if wrong else 0


def cost_table(cost: Cost, settings: dict[str, Any], args: argparse.Namespace) -> str:
    """Markdown: seconds and bytes as measured, and the days of a larger data set."""
    rows = [
        [machines, cost.days(args.objects, args.views, machines), cost.days(args.objects, args.views + 6, machines)]
        for machines in args.machines
    ]
    header = ["machines", f"days, {args.views} views", f"days, with the six input views: {args.views + 6}"]
    return (
        f"Measured at {settings['resolution']}², {settings['samples']} samples"
        f"{', denoised' if settings['denoise'] else ''}: {cost.view:.2f} s an object-view, {cost.overhead:.1f} s "
        f"beside it for every object that is tried, {100 * cost.yielded:.0f}% of them rendered, "
        f"{cost.size / 1e6:.1f} MB an object. For {args.objects:,} objects "
        f"({args.objects * cost.size / 1e12:.2f} TB at that size) this makes:\n\n" + markdown_table(header, rows)
    )


def _kind(reason: str) -> str:
    """A reason without its numbers and names, so that equal ones count together."""
    return re.sub(r"\d+", "N", reason.partition(" (")[0].partition(": N")[0])[:80]
