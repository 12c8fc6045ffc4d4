"""What an object keeps of the run that made it, so that the same can be asked for again: one schema, whoever writes it.

Neither bpy nor torch in this module: the command line writes records, and Blender's panel writes and reads them.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from .errors import ArmError
from .knobs import Knobs, ViewKnobs, knobs_of, values_of

SCHEMA = 1
"""Of what is written; a later program may read it, an earlier one refuses what it does not know. Objects from before
there was a number carry the panel's settings, with `own_weights` and the frame apart, or the command line's, without
views and frame."""

_KEPT = [one for declared in (Knobs, ViewKnobs) for one in knobs_of(declared) if one.kept]


@dataclass(frozen=True)
class AssetRecord:
    """How an object was made. What is None is not known."""

    chosen: dict[str, Any]
    """Values of the knobs that are not the machine's, by their names, weights of the views among them."""
    views: Path | None = None
    """Of the pictures, where they are files; absolute."""
    cameras: tuple[str, ...] | None = None
    """Names of the scene's cameras, where the pictures are theirs."""
    mesh: str | None = None
    """Name of the user's mesh, where the shape is that."""
    frame: tuple[float, ...] | None = None
    """Scale, then the centre's x, y and z: object coordinates times the scale plus the centre are those that the
    cameras of the views are in."""
    report: dict[str, Any] | None = None
    """Of the run that made the maps."""
    shape_report: dict[str, Any] | None = None
    """Of the run that made the shape, where that was another one."""
    versions: dict[str, str] | None = None
    """Of the programs."""

    def as_json(self, folder: Path | None) -> dict[str, Any]:
        """The record as JSON types.

        Args:
            folder: of the .blend. Paths are written relative to it, as `//` says in Blender, but where they lie on
                another drive; None writes them whole.
        """
        rest = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name != "chosen"}
        known = {name: value for name, value in rest.items() if value is not None}
        written = {"schema": SCHEMA} | ({} if folder is None else {"folder": str(folder)}) | self.chosen | known
        return {name: _relative(value, folder) if isinstance(value, Path) else value for name, value in written.items()}


def chosen_values(knobs: Knobs, views: ViewKnobs) -> dict[str, Any]:
    """`AssetRecord.chosen` of a run."""
    values = values_of(Knobs, knobs) | values_of(ViewKnobs, views)
    return {one.name: values[one.name] for one in _KEPT}


def read_record(name: str, text: str, folder: Path | None, frame: Sequence[float] | None = None) -> AssetRecord:
    """The record in a text that an object carries.

    Args:
        name: of the object, for errors.
        text: JSON of `as_json`, or what earlier versions wrote.
        folder: of the .blend that the object is in. The object may come from another one: a path is looked for where
            it was when it was written, then relative to this folder.
        frame: as earlier versions kept it, beside the text.
    Raises:
        ArmError: the text is none of ours.
    """
    try:
        kept = json.loads(text)
        schema = kept.get("schema", 0)
        if schema > SCHEMA:
            raise ArmError(f"{name}: was made by a later version of this program; update it to read its settings")
        if "preset" not in kept:
            raise ValueError("no preset")
        kept = {"weights_folder": kept.get("own_weights")} | kept
        places = [Path(place) for place in (kept.get("folder"), folder) if place is not None]
        chosen = {one.name: kept.get(one.name, one.default) for one in _KEPT}
        paths = {one.name: _absolute(chosen[one.name], places) for one in _KEPT if one.kind is Path}
        rows = {key: tuple(value) for key, value in chosen.items() if isinstance(value, list)}
        found = {entry.name: kept.get(entry.name) for entry in fields(AssetRecord)}
        found |= {"chosen": chosen | paths | rows, "views": _absolute(found["views"], places)}
        found |= {key: tuple(found[key]) for key in ("cameras", "frame") if found[key] is not None}
    except (TypeError, ValueError, AttributeError) as error:
        raise ArmError(f"{name}: carries no settings of ours; generate it anew") from error
    if found["frame"] is None and frame is not None:
        found["frame"] = tuple(frame)
    return AssetRecord(**found)


def _relative(path: Path, folder: Path | None) -> str:
    path = path.absolute()
    try:
        return str(path) if folder is None else "//" + Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # Of another drive.
        return str(path)


def _absolute(text: str | None, places: list[Path]) -> Path | None:
    """The path that is written as `text`: in the first of `places` where there is one, else in the last."""
    if not text:
        return None
    if not text.startswith("//") or not places:
        return Path(text)
    found = [Path(os.path.normpath(place / text[2:])) for place in places]
    return next((path for path in found if path.exists()), found[-1])
