"""Weights of other projects come to their place: from a file, from a folder, or on the user's word from the web.

Nothing here knows bpy, and nothing asks: who calls `download` has shown the licence, has heard a yes, and inside
Blender has seen that `bpy.app.online_access` allows it. It may run on a worker thread.
"""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from . import checkpoints
from .errors import CheckpointError, DownloadError
from .fetch import fetch
from .files import check_output, whole_file
from .progress import Progress, part, silent
from .weights_import import import_weights
from .weights_registry import Weights

DOWNLOADS = "downloads"
"""Beside the installed weights: what is being downloaded, as its publisher made it. It goes once it is installed."""

_FETCHING = 0.95
"""Of the progress of a download; the rest is the conversion."""

MATTING = "matting"
"""The kind of weights that is taken as it is: an ONNX model."""


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
    if weights.file is None:
        raise DownloadError(f"{name}: nobody publishes these weights; {weights.remedy}")
    if checkpoints.condition(name) == "whole":
        progress(1.0, f"{place.name} is there")
        return Installed(place, name, weights.licence)
    folder = place.parent / DOWNLOADS
    try:
        source = fetch(weights.file, folder, part(progress, 0.0, _FETCHING))
    except DownloadError as error:
        raise DownloadError(f"{error}; {by_hand(weights)}") from error
    progress(_FETCHING, f"installing {place.name}")
    installed = _install(source, weights)
    source.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()
    return installed


def by_hand(weights: Weights) -> str:
    """What a user without network puts where."""
    return (
        f"bring {weights.file.name} from another machine: python -m arm_blender weights import {weights.file.name} "
        f"--as {weights.kind} makes {checkpoints.shipped(weights.name)} of it"
    )


def install(source: Path, kind: str | None = None, output: Path | None = None) -> Iterator[Installed]:
    """Converts and records what the user has brought; yields each of the weights as it is done.

    Args:
        source: a file, or a folder with files that the registry knows by their names, ours included.
        kind: "georm", "image-encoder", "material-encoder" or "matting"; None tells it by the name, and takes all of
            a folder.
        output: of a single file; None puts it where it is looked for, and records its hash.
    Raises:
        CheckpointError: unknown by its name, damaged, or another network than it should be.
        OutputError: the result cannot be written.
    """
    wanted = [weights for weights in checkpoints.REGISTRY if weights.kind and kind in (None, weights.kind)]
    if source.is_dir():
        pairs = [(found, weights) for weights in wanted if (found := _first(source, weights)) is not None]
    else:
        pairs = [(source, weights) for weights in wanted if kind is not None or source.name in weights.names]
    if not pairs:
        names = ", ".join(name for weights in wanted for name in weights.names)
        raise CheckpointError(f"{source}: no weights that are known by their names ({names}); name the file, and --as")
    if output is not None and len(pairs) > 1:
        raise CheckpointError(f"{source}: holds several weights, but --output names one file; name the file too")
    for found, weights in pairs:
        yield _install(found, weights, output)


def _first(folder: Path, weights: Weights) -> Path | None:
    return next((folder / name for name in weights.names if (folder / name).is_file()), None)


def _install(source: Path, weights: Weights, output: Path | None = None) -> Installed:
    """One file, by what it holds: an ONNX model, a file that this program wrote, or a checkpoint to convert."""
    place = output or checkpoints.shipped(weights.name)
    check_output(place.parent)
    if weights.kind == MATTING:
        from .views.matting import check_model

        check_model(source)
        known = weights.file is not None and source.name == weights.file.name
        installed = Installed(place, source.name, weights.licence if known else "that of its publisher")
    elif source.name == weights.file_name:
        header = checkpoints.read_header(source)
        recorded = checkpoints.recorded_sums(source.parent).get(source.name)
        if header["name"] != weights.name or recorded not in (None, checkpoints.sha256(source)):
            raise CheckpointError(
                f"{source}: damaged, or not what its name says; copy it again with {checkpoints.SUMS}"
            )
        installed = Installed(place, header.get("origin", weights.name), header.get("licence", weights.licence))
    else:
        path, converted = import_weights(source, weights.kind, output)
        return Installed(path, converted.origin, converted.licence)
    with whole_file(place) as temporary:
        shutil.copyfile(source, temporary)
    if output is None:
        checkpoints.record(place.parent, only=place)
    return installed
