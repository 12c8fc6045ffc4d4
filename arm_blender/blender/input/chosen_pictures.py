"""What the user chose in a file browser, as the one path that a request takes. No bpy in this module."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from ...errors import ArmError
from ...machine.files import replace_folder, staging
from ...machine.picture_files import SUFFIXES, is_video, pictures_in


def chosen_path(folder: Path, names: Sequence[str]) -> Path:
    """The path of chosen files: the file where it is one, the folder where it is all of it, else a folder of them.

    The folder of some pictures of another is made beside that, of links where the disk has such; one that holds the
    same pictures already is taken again.

    Args:
        folder: of the files.
        names: of the files, in any order; none stands for the folder.
    Raises:
        ArmError: a video was chosen together with something else, or something that is no picture.
        OutputError: the folder of the chosen pictures cannot be made.
    """
    chosen = [folder / name for name in sorted(set(names)) if name]
    if not chosen:
        return folder
    if len(chosen) == 1:
        return chosen[0]
    for path in chosen:
        if is_video(path):
            raise ArmError(f"{path.name}: is a video; choose it alone, or pictures only")
        if path.suffix.lower() not in SUFFIXES:
            raise ArmError(f"{path.name}: is no picture; choose pictures only")
    if chosen == pictures_in(folder):
        return folder
    return _folder_of(chosen, folder)


def _folder_of(chosen: list[Path], folder: Path) -> Path:
    """A folder beside `folder` with these pictures of it."""
    number = 1
    while True:
        name = f"{folder.name or 'pictures'}-chosen{'' if number == 1 else f'-{number}'}"
        place = folder.parent / name if folder.name else folder / name
        if not place.exists():
            break
        if place.is_dir() and _states(pictures_in(place)) == _states(chosen):
            return place
        number += 1
    with staging(place.parent) as stage:
        made = stage / name
        made.mkdir()
        for path in chosen:
            try:
                os.link(path, made / path.name)
            except OSError:  # Another disk, or one without links.
                shutil.copy2(path, made / path.name)
        replace_folder(place, made, stage / "older")
    return place


def _states(paths: list[Path]) -> list[tuple[str, int, int]]:
    """What tells pictures apart without reading them."""
    return [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in paths]
