"""One folder holds one asset: another's files are not written over, the same asset made again replaces itself."""

import json
import os
from pathlib import Path
from typing import Any

from ..errors import OutputError
from ..machine.files import UNFINISHED
from ..report import FILE_NAME

_MOST_BYTES = 2**24
"""Of a report; a larger one is none of ours."""


def source_of(views: Path, directory: Path) -> str:
    """How the report in `directory` names the views that an asset was made of: so that both may be moved together.

    Cameras in a file stand for the folder that they are in.
    """
    place = os.path.realpath(views.parent if views.suffix.lower() == ".json" else views)
    try:
        return Path(os.path.relpath(place, os.path.realpath(directory))).as_posix()
    except ValueError:  # Another drive, on Windows.
        return Path(place).as_posix()


def check_asset_folder(directory: Path, name: str | None, views: Path) -> None:
    """Makes sure that what is in `directory` is of the asset that is to be written there, or of none.

    Views that lie in the folder itself are those that an earlier run has left there for another.

    Args:
        directory: need not exist.
        name: of the asset to be written; None before it is known, when only its views are compared.
        views: that it is made of.
    Raises:
        OutputError: another asset's files are there, or a .blend that no run has written.
    """
    if not directory.is_dir():
        return
    remedy = "choose a folder of its own with --output, or take away what is there"
    report = _report(directory)
    if report is not None and Path(os.path.realpath(views)).is_relative_to(os.path.realpath(directory)):
        return
    if report is not None and isinstance(report.get("name"), str):
        made_of = report.get("views")
        if name is not None and report["name"] != name:
            raise OutputError(f"{directory}: holds the asset {report['name']}, and would get that of {name}; {remedy}")
        if isinstance(made_of, str) and made_of != source_of(views, directory):
            raise OutputError(
                f"{directory}: holds the asset {report['name']}, made of {made_of}, not of {views}; {remedy}"
            )
        return
    # Reports of earlier versions say no name.
    if name is None:
        return
    blends = sorted(path.name for path in directory.glob("*.blend"))
    if blends and (report is None or f"{name}.blend" not in blends):
        raise OutputError(f"{directory}: holds {blends[0]}, which is not of this asset; {remedy}")


def _report(directory: Path) -> dict[str, Any] | None:
    """What the report of a folder says, or that of a run which was killed while it put its files there."""
    for place in (directory / FILE_NAME, *directory.glob(f"{UNFINISHED}*/{FILE_NAME}")):
        try:
            if place.stat().st_size <= _MOST_BYTES:
                found = json.loads(place.read_text(encoding="utf-8"))
                if isinstance(found, dict) and "version" in found:
                    return found
        except (OSError, ValueError, RecursionError):
            continue
    return None
