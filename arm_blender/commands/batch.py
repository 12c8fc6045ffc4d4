"""Make many assets, one after another or side by side; one line of JSON per item on stdout."""

from __future__ import annotations

import argparse
import csv
import json
import logging
import sys
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

from ..errors import ArmError, InputImageError
from ..files import check_output
from . import UsageError, generate, interrupts

logger = logging.getLogger(__name__)

_COLUMNS = {
    "elevation": float,
    "fovy": float,
    "rig_distance": float,
    "seed": int,
    "mesh": Path,
    "view_weights": generate.view_weights,
}
"""What an item may say for itself, besides `views` and `name`; everything else is said once for all."""


@dataclass(frozen=True)
class Item:
    """One object of a batch.

    Attributes:
        views: as `generate` takes them.
        name: of the asset and of its folder; no other item has it.
        options: over those of the command line.
    """

    views: Path
    name: str
    options: dict[str, Any] = field(default_factory=dict)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "items",
        type=Path,
        metavar="LIST",
        help=f".txt, .csv or .json of views, name, {', '.join(_COLUMNS)}; or a folder",
    )
    parser.add_argument("--resume", action="store_true", help="skip items whose result is whole")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes side by side (default: 1)")
    generate.add_options(parser)


def run(args: argparse.Namespace) -> int:
    if args.jobs < 1:
        raise UsageError(f"--jobs {args.jobs}: give at least 1")
    check_output(args.output)
    items = read_items(args.items, args.output)
    # What is said once for all is refused once, before any work.
    generate.settings_of(args)
    generate.view_options_of(args)
    failed = 0
    for line in _lines(items, args):
        # A foreign byte in a file's name is no JSON, and no stream takes it.
        print(json.dumps(line, ensure_ascii=False).encode("utf-8", "replace").decode(), flush=True)
        failed += line["status"] == "failed"
    return 1 if failed else 0


def read_items(path: Path, output: Path) -> list[Item]:
    """The items of a list or folder. Relative paths in a list are relative to the list.

    Args:
        path: of the list or folder.
        output: of the batch. A folder's items are not looked for there: a second run would take results for views.
    Raises:
        UsageError: `path` is a folder, and the output as well.
        InputImageError: the list is missing, empty or malformed; the line names the entry.
    """
    if path.is_dir():
        if output.resolve() == path.resolve():
            raise UsageError(f"--output {output}: is the folder of the items; choose another")
        rows = [{"views": found.name} for found in _views_in(path, output)]
        folder = path
    else:
        rows, folder = _rows(path), path.parent
    if not rows:
        raise InputImageError(f"{path}: no items; give a list of views, or a folder of images and of folders of views")
    items: list[Item] = []
    taken: set[str] = set()
    for number, row in enumerate(rows, start=1):
        item = _item(row, folder, f"{path}: item {number}")
        name, copies = item.name, 1
        while name in taken:
            copies += 1
            name = f"{item.name}-{copies}"
        taken.add(name)
        items.append(Item(item.views, name, item.options))
    return items


def _views_in(folder: Path, output: Path) -> list[Path]:
    """What may be views in a folder: its images and its sub-folders, by name; not the one that holds `output`."""
    from ..views.image_io import SUFFIXES

    try:
        found = [path for path in folder.iterdir() if path.is_dir() or path.suffix.lower() in SUFFIXES]
    except OSError as error:
        raise InputImageError(f"{folder}: cannot be read ({error.strerror}); check its rights") from error
    results = output.resolve()
    return sorted(path for path in found if path.name[0] != "." and not results.is_relative_to(path.resolve()))


def _rows(path: Path) -> list[Any]:
    """The entries of a list, each a path or a mapping."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        if path.suffix.lower() == ".json":
            rows = json.loads(text)
            if not isinstance(rows, list):
                raise InputImageError(f"{path}: not a JSON list; give a list of paths, or of objects with views")
            return rows
        if path.suffix.lower() == ".csv":
            return [{key: value for key, value in row.items() if value} for row in csv.DictReader(text.splitlines())]
    except OSError as error:
        raise InputImageError(f"{path}: cannot be read ({error.strerror}); give a list or a folder") from error
    except (ValueError, RecursionError, csv.Error) as error:
        raise InputImageError(f"{path}: not a readable list ({error}); give .txt, .csv or .json") from error
    lines = (line.strip() for line in text.splitlines())
    return [line for line in lines if line and not line.startswith("#")]


def _item(row: Any, folder: Path, where: str) -> Item:
    row = {"views": row} if isinstance(row, str) else row
    if not isinstance(row, dict) or not isinstance(row.get("views"), str) or not row["views"]:
        raise InputImageError(f"{where}: no views; name an image or a folder in the column views")
    unknown = [str(key) for key in row if key not in {"views", "name", *_COLUMNS}]
    if unknown:
        raise InputImageError(f"{where}: unknown column {unknown[0]}; use views, name, {', '.join(_COLUMNS)}")
    options = {}
    for key, convert in _COLUMNS.items():
        if key in row:
            value = row[key]
            text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
            try:
                options[key] = convert(text)
            except (ValueError, argparse.ArgumentTypeError) as error:
                raise InputImageError(f"{where}: {key} is {value!r}; correct it") from error
    if "mesh" in options:
        options["mesh"] = folder / options["mesh"]
    views = folder / row["views"]
    try:
        name = str(row.get("name") or (views.resolve().name if views.is_dir() else views.stem))
    except (OSError, ValueError, RuntimeError) as error:  # Too long, a character no name has, links in a circle.
        raise InputImageError(f"{where}: views is {row['views'][:40]!r}, no path; correct it") from error
    if not name or Path(name).name != name or name.startswith("."):
        raise InputImageError(f"{where}: name is {name!r}; give a plain file name")
    return Item(views, name, options)


def _lines(items: list[Item], args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """One line per item, in the order in which they end."""
    if args.jobs == 1:
        yield from (_made(item, args) for item in items)
        return
    quiet = argparse.Namespace(**{key: value for key, value in vars(args).items() if key != "run"})
    quiet.progress = "never"
    signals = interrupts.watched()
    # A forked copy of a process that has run torch can hang: each worker starts afresh.
    pool = ProcessPoolExecutor(
        min(args.jobs, len(items)), get_context("spawn"), initializer=interrupts.watch, initargs=(signals, True)
    )
    try:
        waiting = {pool.submit(_made_by_worker, item, quiet, signals): item for item in items}
        for done in as_completed(waiting):
            yield _result(done, waiting[done], args)
    except BaseException:
        for worker in active_children():
            worker.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _made_by_worker(item: Item, args: argparse.Namespace, signals: list[int]) -> dict[str, Any]:
    """`_made` in another process, which an interruption stops at once, and for good."""
    interrupts.watch(signals)
    try:
        interrupts.check()
        return _made(item, args)
    finally:
        interrupts.watch(signals, idle=True)


def _result(done: Future, item: Item, args: argparse.Namespace) -> dict[str, Any]:
    """The line of an item; a worker that the system has killed fails those that are left, and no result is lost."""
    try:
        return done.result()
    except BrokenExecutor:
        error = f"{item.views}: a worker was killed, most likely for memory; use fewer --jobs, with --resume"
        print(f"arm: {error}", file=sys.stderr)
        return {"views": str(item.views), "output": str(args.output / item.name), "status": "failed", "error": error}


def _made(item: Item, args: argparse.Namespace) -> dict[str, Any]:
    """Makes one item; an error of its own becomes its line and does not stop the others."""
    from ..export import is_whole
    from .progress_line import shown

    output = args.output / item.name
    line: dict[str, Any] = {"views": str(item.views), "output": str(output)}
    if args.resume and is_whole(output):
        return line | {"status": "skipped"}
    start = time.perf_counter()
    own = argparse.Namespace(**(vars(args) | item.options | {"views": item.views, "output": output}))
    try:
        with shown(args.progress) as progress:
            report, _ = generate.produce(own, progress, item.name)
    except ArmError as error:
        print(f"arm: {error}", file=sys.stderr)
        return line | {"status": "failed", "error": str(error), "seconds": _since(start)}
    except Exception as error:  # A bug met by one item is shown whole, and the others still get their turn.
        logger.exception("%s", item.views)
        reason = f"{item.views}: internal error ({type(error).__name__}: {error}); please report it"
        return line | {"status": "failed", "error": reason, "seconds": _since(start)}
    data = report.as_dict()
    return line | {"status": "done", "seconds": _since(start), "faces": data["faces"], "left_out": data["left_out"]}


def _since(start: float) -> float:
    return round(time.perf_counter() - start, 3)
