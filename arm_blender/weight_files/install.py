"""Weights of other projects come to their place: from a file, from a folder, or on the user's word from the web.

Nothing here knows bpy, and nothing asks: who calls `download` has shown the licence, has heard a yes, and inside
Blender has seen that `bpy.app.online_access` allows it. It may run on a worker thread.
"""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..errors import CheckpointError, DownloadError
from ..machine.fetch import fetch
from ..machine.files import check_output, whole_file
from ..progress import Progress, part, silent
from . import checkpoints
from .imported import import_weights
from .matting_model import MATTING, check_model
from .registry import Weights

DOWNLOADS = "downloads"
"""Beside the installed weights: what is being downloaded, as its publisher made it. It goes once it is installed."""

_FETCHING = 0.95
"""Of the progress of a download; the rest is the conversion."""


@dataclass(frozen=True)
class Installed:
    """What has been installed.

    Attributes:
        path: of the file.
        origin: whose weights they are.
        licence: of the weights.
    """

    path: Path
    origin: str
    licence: str


def download(name: str, progress: Progress = silent) -> Installed:
    """Downloads registered weights, verifies, converts and records them.

    What has arrived when `progress` raises, or when the network fails, is continued by the next call.

    Args:
        name: of the registry, such as "instantmesh.georm".
    Raises:
        DownloadError: nobody publishes them, or the file cannot be had; the line says what to put where.
        CheckpointError: what came is not the network that it should be, or there is no such name.
        OutputError: the folder of weights cannot be written, or has no room.
        Cancelled: by `progress`.
    """
    weights = checkpoints.registered(name)
    place = checkpoints.shipped(name)
    if not weights.files:
        raise DownloadError(f"{name}: nobody publishes these weights; {weights.remedy}")
    if checkpoints.condition(name) == "whole":
        progress(1.0, f"{place.name} is there")
        return Installed(place, name, weights.licence)
    folder = place.parent / DOWNLOADS
    sources = []
    for index, file in enumerate(weights.files):
        start, end = (_FETCHING * edge / len(weights.files) for edge in (index, index + 1))
        try:
            sources.append(fetch(file, folder, part(progress, start, end)))
        except DownloadError as error:
            raise DownloadError(f"{error}; {by_hand(weights)}") from error
    progress(_FETCHING, f"installing {place.name}")
    installed = _install(tuple(sources), weights)
    for source in sources:
        source.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()
    return installed


def by_hand(weights: Weights) -> str:
    """What a user without network puts where."""
    names = [file.name for file in weights.files]
    what = names[0] if len(names) == 1 else "FOLDER"
    return (
        f"bring {' and '.join(names)} from another machine: python -m arm_blender weights import {what} "
        f"--as {weights.kind} makes {checkpoints.shipped(weights.name)} of it"
    )


def install(source: Path, kind: str | None = None, output: Path | None = None) -> Iterator[Installed]:
    """Converts and records what the user has brought; yields each of the weights as it is done.

    Args:
        source: a file, or a folder with files that the registry knows by their names, ours included.
        kind: "georm", "image-encoder", "material-encoder", "lpips" or "matting"; None tells it by the name, and takes
            all of a folder.
        output: of a single file; None puts it where it is looked for, and records its hash.
    Raises:
        CheckpointError: unknown by its name, damaged, or another network than it should be.
        OutputError: the result cannot be written.
    """
    wanted = [weights for weights in checkpoints.REGISTRY if weights.kind and kind in (None, weights.kind)]
    if source.is_dir():
        pairs = [(found, weights) for weights in wanted if (found := _first(source, weights))]
    else:
        named = (source.name,)
        pairs = [((source,), weights) for weights in wanted if kind is not None or named in weights.choices]
    if not pairs:
        names = ", ".join(" with ".join(choice) for weights in wanted for choice in weights.choices)
        raise CheckpointError(f"{source}: no weights that are known by their names ({names}); name the file, and --as")
    if output is not None and len(pairs) > 1:
        raise CheckpointError(f"{source}: holds several weights, but --output names one file; name the file too")
    for found, weights in pairs:
        yield _install(found, weights, output)


def _first(folder: Path, weights: Weights) -> tuple[Path, ...]:
    """The files of the best choice that is there; none where none is."""
    choices = (tuple(folder / name for name in choice) for choice in weights.choices)
    return next((paths for paths in choices if all(path.is_file() for path in paths)), ())


def _install(sources: tuple[Path, ...], weights: Weights, output: Path | None = None) -> Installed:
    """Files by what they hold: an ONNX model, what this program wrote, or a checkpoint to convert."""
    source, *rest = sources
    place = output or checkpoints.shipped(weights.name)
    check_output(place.parent)
    if weights.kind == MATTING:
        check_model(source)
        known = (source.name,) == weights.choices[1]
        installed = Installed(place, source.name, weights.licence if known else "that of its publisher")
    elif source.name == weights.file_name:
        header = checkpoints.read_header(source)
        recorded = checkpoints.recorded_sum(source)
        if header["name"] != weights.name or recorded not in (None, checkpoints.sha256(source)):
            with_sum = f"{source.name}{checkpoints.SUM}"
            raise CheckpointError(f"{source}: damaged, or not what its name says; copy it again with {with_sum}")
        installed = Installed(place, header.get("origin", weights.name), header.get("licence", weights.licence))
    else:
        path, converted = import_weights(source, weights.kind, output, *rest)
        return Installed(path, converted.origin, converted.licence)
    with whole_file(place) as temporary:
        shutil.copyfile(source, temporary)
    if output is None:
        checkpoints.record(place)
    return installed
