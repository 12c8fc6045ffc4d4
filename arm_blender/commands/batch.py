"""Make many assets, one after another or side by side; one line of JSON per item on stdout."""

from __future__ import annotations

import argparse
import csv
import json
import logging
import os
import platform
import sys
import time
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from ..errors import ArmError, InputImageError
from ..knobs import Knobs, ViewKnobs, knobs_of
from ..machine.files import check_output, clear_unfinished, distinct
from ..version import VERSION
from . import UsageError, generate, mesh_option, workers

logger = logging.getLogger(__name__)

_COLUMNS: dict[str, tuple[str, Callable[[str], Any]]] = {
    **{one.column: (one.name, one.kind) for kind in (Knobs, ViewKnobs) for one in knobs_of(kind) if one.listed},
    "mesh": ("mesh", Path),
    "mesh_up": ("mesh_up", mesh_option.up),
    "place": ("place", generate.placement),
}
"""What an item may say for itself, besides `views` and `name`, with the option that it is; all else is said once."""

WORKER = "arm_blender.commands.batch"
"""Whose `answer` other processes call: this module, by the name that it has for them."""

EPILOG = f"""LIST is a folder of images, of videos and of folders of views or photographs; a .txt of one path a line; a
.csv with a column views; or a .json list of paths and of objects with views. A csv or json item may also have a name,
and options of its own over those of the command line: {", ".join(_COLUMNS)}. An empty field leaves the command line's.
Relative paths are relative to the list. stdout gets one line of JSON an item, as it ends: views, output, status (done,
skipped or failed), seconds of each stage, total_seconds, seed, versions, and the error where there is one."""


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
        help="a folder, .txt, .csv or .json; see below",
    )
    parser.epilog = EPILOG
    parser.add_argument("--resume", action="store_true", help="skip items whose result is whole")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes that share the cores (default: 1)")
    generate.add_options(parser)


def run(args: argparse.Namespace) -> int:
    if args.jobs < 1:
        raise UsageError(f"--jobs {args.jobs}: give at least 1")
    check_output(args.output)
    items = read_items(args.items, args.output)
    # What is said once for all is refused once, before any work.
    generate.settings_of(args)
    generate.view_options_of(args)
    generate.formats_of(args)
    for item in items:
        clear_unfinished(args.output / item.name)  # Of a run that was killed.
    failed = 0
    with closing(_lines(items, args)) as lines:
        for line in lines:
            # A foreign byte in a file's name is no JSON, and no stream takes it.
            print(json.dumps(line, ensure_ascii=False).encode("utf-8", "replace").decode(), flush=True)
            failed += line["status"] == "failed" or (args.strict and bool(line.get("doubts")))
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
    items = [_item(row, folder, f"{path}: item {number}") for number, row in enumerate(rows, start=1)]
    names = distinct(item.name for item in items)
    return [replace(item, name=name) for item, name in zip(items, names, strict=True)]


def _views_in(folder: Path, output: Path) -> list[Path]:
    """What may be views in a folder: its images and its sub-folders, by name; not the one that holds `output`."""
    from ..machine.picture_files import SUFFIXES, is_video

    try:
        found = [
            path for path in folder.iterdir() if path.is_dir() or path.suffix.lower() in SUFFIXES or is_video(path)
        ]
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
    for key, (option, convert) in _COLUMNS.items():
        if key in row:
            value = row[key]
            text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
            try:
                options[option] = convert(text)
            except (ValueError, argparse.ArgumentTypeError) as error:
                raise InputImageError(f"{where}: {key} is {value!r}; correct it") from error
    if "mesh" in options:
        options["mesh"] = folder / options["mesh"]
    views = folder / row["views"]
    try:
        os.fsencode(views)
        name = str(row.get("name") or (views.resolve().name if views.is_dir() else views.stem))
    except (OSError, ValueError, RuntimeError) as error:  # Too long, a character no name has, links in a circle.
        raise InputImageError(f"{where}: views is {row['views'][:40]!r}, no path; correct it") from error
    try:
        short = _short(name)
    except UnicodeEncodeError:  # Half a character, which JSON can spell.
        short = ""
    if not short or Path(name).name != name or name.startswith(".") or "\0" in name:
        raise InputImageError(f"{where}: name is {name[:40]!r}; give a plain file name")
    return Item(views, short, options)


def _short(name: str) -> str:
    """`name` where files can have it, a number behind included, else its beginning: the others get their turn.

    Bytes of a file's name that are no UTF-8 become "_".
    """
    plain = "".join("_" if "\udc80" <= letter <= "\udcff" else letter for letter in name)
    return plain.encode()[: generate.LONGEST_NAME - 10].decode("utf-8", "ignore")


def _lines(items: list[Item], args: argparse.Namespace) -> Generator[dict[str, Any], None, None]:
    """One line per item, in the order in which they end."""
    if args.jobs == 1:
        yield from (_made(item, args) for item in items)
        return
    words = {key: value for key, value in vars(args).items() if key != "run"} | {"progress": "never"}
    rows = [asdict(item) for item in items]
    with closing(workers.side_by_side(rows, args.jobs, WORKER, words)) as answers:
        for row, line in answers:
            yield line or _killed(Item(**row), args)


def answer(row: dict[str, Any], words: dict[str, Any]) -> dict[str, Any]:
    """`_made` in another process."""
    return _made(Item(**row), argparse.Namespace(**words))


def _killed(item: Item, args: argparse.Namespace) -> dict[str, Any]:
    """The line of an item whose process the system has killed."""
    output = args.output / item.name
    clear_unfinished(output)
    error = f"{item.views}: its process was killed, most likely for memory; use fewer --jobs, with --resume"
    print(f"arm: {error}", file=sys.stderr)
    return {"views": str(item.views), "output": str(output), "status": "failed", "error": error}


def _made(item: Item, args: argparse.Namespace) -> dict[str, Any]:
    """Makes one item; an error of its own becomes its line and does not stop the others."""
    from ..export import is_whole
    from .progress_line import shown

    own = argparse.Namespace(**(vars(args) | item.options | {"views": item.views, "output": args.output / item.name}))
    line: dict[str, Any] = {"views": str(own.views), "output": str(own.output)}
    if args.resume and is_whole(own.output):
        return line | {"status": "skipped"}
    start = time.perf_counter()
    outcome: dict[str, Any] = {"status": "failed"}
    try:
        with shown(args.progress) as progress:
            report, _ = generate.produce(own, progress, item.name)
        generate.say_doubts(report, f"{item.views}: ")
        data = report.as_dict()
        outcome = {"status": "done"} | {name: data[name] for name in ("seconds", "faces", "doubts", "left_out")}
    except ArmError as error:
        print(f"arm: {error}", file=sys.stderr)
        outcome["error"] = str(error)
    except Exception as error:  # A bug met by one item is shown whole, and the others still get their turn.
        logger.exception("%s", item.views)
        outcome["error"] = f"{item.views}: internal error ({type(error).__name__}: {error}); please report it"
    outcome["total_seconds"] = round(time.perf_counter() - start, 3)
    return line | outcome | {"seed": own.seed, "versions": _versions()}


def _versions() -> dict[str, str]:
    """What made an item: the program, Python, torch, and Blender where it is there."""
    import torch

    versions = {"arm_blender": VERSION, "python": platform.python_version(), "torch": torch.__version__}
    bpy = sys.modules.get("bpy")
    return versions | ({"blender": bpy.app.version_string} if bpy is not None else {})
