"""An asset on disk: the mesh in one format or several, the texture maps, report.json. No bpy in this package."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import ArmError, OutputError
from ..machine.files import check_output, staging, write_json
from ..progress import Progress, silent
from ..report import FILE_NAME, Report
from ..structures import RelightableAsset
from ..uv.finish import finished
from .gltf import write_glb
from .light_file import COMPARISON, LIGHT, write_light
from .obj import write_obj
from .regions_picture import write_regions_picture
from .textures import FOLDER, PREDICTED, REGIONS, SET_BY_HAND, write_regions, write_textures
from .usd import write_usd, write_usdz


@dataclass(frozen=True)
class Format:
    """A way to write an asset.

    Attributes:
        suffix: of its file.
        write: the asset to a path of that suffix; the textures lie in `FOLDER` beside it.
    """

    suffix: str
    write: Callable[[RelightableAsset, Path], None]


FORMATS = {
    "glb": Format(".glb", write_glb),
    "usd": Format(".usda", write_usd),
    "usdz": Format(".usdz", write_usdz),
    "obj": Format(".obj", write_obj),
}
"""What an asset can be written as, by the name that a user gives."""

DEFAULT = ("glb",)


def formats_of(text: str) -> tuple[str, ...]:
    """The formats in words separated by commas, each once.

    Raises:
        ArmError: one is unknown.
    """
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    for name in names:
        if name not in FORMATS:
            raise ArmError(f"--export {name}: unknown; choose of {', '.join(FORMATS)}")
    return names


def written_names(name: str, formats: Sequence[str]) -> list[str]:
    """The files of an asset called `name`, relative to its folder: all that `write_asset` and Blender may write."""
    suffixes = [".blend", *(FORMATS[chosen].suffix for chosen in formats), *([".mtl"] if "obj" in formats else [])]
    textures = [f"{FOLDER}/{kind}.png" for kind in ("albedo", "roughness", "metallic", "baked", "normal")]
    textures += [f"{FOLDER}/{REGIONS}", *(f"{FOLDER}/{PREDICTED}/{kind}.png" for kind in SET_BY_HAND)]
    pictures = [REGIONS, LIGHT, COMPARISON, "preview.png"]
    return [*(f"{name}{suffix}" for suffix in suffixes), *textures, *pictures, FILE_NAME]


def write_asset(
    asset: RelightableAsset,
    report: Report,
    directory: Path,
    progress: Progress = silent,
    further: Callable[[Path], None] | None = None,
    formats: Sequence[str] = DEFAULT,
) -> list[Path]:
    """Writes an asset as a whole: while anything is missing, `directory` has no report.json, or still the older asset.

    Args:
        asset: what to write; its maps as predicted, with the finishes that were set in `maps.regions`.
        report: is written last.
        directory: is made where it is missing; files of the same names are replaced, others stay.
        progress: is told each file.
        formats: of `FORMATS`.
        further: writes more files into the folder that it is given, under names that are not taken: the .blend.
    Returns:
        The files, report.json last.
    Raises:
        OutputError: something cannot be written.
        Cancelled: by `progress`; nothing was changed.
    """
    check_output(directory)
    with staging(directory) as stage:
        with report.stage("files"):
            _write_formats(asset, stage, formats, progress)
        if further is not None:
            further(stage)
        progress(1.0, "writing report.json")
        report.write(stage / FILE_NAME)
        return _move_into(directory, stage)


def rewrite_asset(
    asset: RelightableAsset,
    report: dict[str, Any],
    directory: Path,
    formats: Sequence[str],
    progress: Progress = silent,
    further: Callable[[Path], None] | None = None,
) -> list[Path]:
    """As `write_asset`, of an asset that was written before, with what its report says now."""
    check_output(directory)
    with staging(directory) as stage:
        _write_formats(asset, stage, formats, progress)
        if further is not None:
            further(stage)
        progress(1.0, "writing report.json")
        write_json(stage / FILE_NAME, report)
        return _move_into(directory, stage)


def write_files(asset: RelightableAsset, directory: Path, formats: Sequence[str]) -> list[Path]:
    """Writes an asset in `formats` with its textures, and no report: all of the files or none.

    Raises:
        OutputError: something cannot be written.
    """
    check_output(directory)
    with staging(directory) as stage:
        _write_formats(asset, stage, formats, silent)
        return _move_into(directory, stage)


def is_whole(directory: Path) -> bool:
    """Whether `directory` holds an asset that was written to its end."""
    return (directory / FILE_NAME).is_file()


def _write_formats(asset: RelightableAsset, stage: Path, formats: Sequence[str], progress: Progress) -> None:
    progress(0.0, "writing textures")
    predicted, asset = asset, replace(asset, maps=finished(asset.maps))
    write_textures(asset.maps, stage / FOLDER)
    write_regions(predicted.maps, stage / FOLDER)
    write_regions_picture(asset, stage / REGIONS)
    if asset.maps.light is not None:
        write_light(asset.maps.light, stage / LIGHT)
    for name in formats:
        path = stage / f"{asset.name}{FORMATS[name].suffix}"
        progress(0.5, f"writing {path.name}")
        FORMATS[name].write(asset, path)


def _move_into(directory: Path, stage: Path) -> list[Path]:
    """Moves the files of `stage` to their places; the older report.json goes first and the new one comes last.

    Raises:
        OutputError: something else is where a file or a folder has to be; nothing was moved.
    """
    files = sorted(path.relative_to(stage) for path in stage.rglob("*") if path.is_file())
    files.sort(key=lambda path: path == Path(FILE_NAME))
    for target in (directory / path for path in files):
        if target.is_dir():
            raise OutputError(f"{target}: is a folder where a file has to be; move it away or change --output")
        if target.parent.exists() and not target.parent.is_dir():
            raise OutputError(f"{target.parent}: is a file where a folder has to be; move it away or change --output")
    if is_whole(directory):  # What an older asset had and this one has not, would be taken for its own.
        for name in (LIGHT, COMPARISON):
            if not (stage / name).exists():
                (directory / name).unlink(missing_ok=True)
    (directory / FILE_NAME).unlink(missing_ok=True)
    for path in files[:-1]:
        (directory / path).parent.mkdir(exist_ok=True)
        os.replace(stage / path, directory / path)
    older = directory / FOLDER / PREDICTED
    if older.is_dir() and not (stage / FOLDER / PREDICTED).exists():  # Of finishes that are not set any more.
        for name in SET_BY_HAND:
            (older / f"{name}.png").unlink(missing_ok=True)
        if not any(older.iterdir()):
            older.rmdir()
    os.replace(stage / files[-1], directory / files[-1])
    return [directory / path for path in files]
