"""Samples on disk: of every object `mesh.npz` and one `rig_<k>.npz` per rendered rig, and `occupancy.npz` beside.

A sample is addressed by a path, `SHARDS/<id>/rig_<k>.npz`. The file is there, or `<id>.rig_<k>.npz` is a member of one
of the folder's tar shards (see shard_writer.py); `arrays` reads either. What is derived later is always a file.

rig_<k>.npz, V views of S x S pixels, the first six of them inputs: rgba (V, S, S, 4) uint8 sRGB with straight alpha,
albedo (V, S, S, 3) uint8 sRGB, roughness and metallic (V, S, S) uint8, depth (V, S, S) float16 along the view axis with
infinity as background, normal (V, S, S, 3) int8 world, c2w (V, 4, 4), K (V, 3, 3).
mesh.npz, the true surface: vertices (N, 3) float32 world, faces (F, 3) int32.
occupancy.npz, points around it: points (P, 3) float16 world, distance (P,) float16 world units, positive inside.
"""

import fnmatch
import io
import json
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import Camera
from arm_blender.machine.files import whole_file
from arm_blender.structures import TriangleMesh

from .manifest import read_manifest

Arrays = dict[str, NDArray[Any]]
"""The arrays of one file by their names, each of a type of its own."""

INDEXES = "[0-9]*.json"
"""Names of the shards' indexes. A tar without one is not finished, and is not read."""


class Place(NamedTuple):
    """Where a member's bytes lie."""

    shard: Path
    offset: int
    size: int


_known: dict[Path, dict[str, dict[str, Place]]] = {}
"""Of each folder of shards, the members found so far, of each object by name; thousands of indexes take seconds."""


def save_arrays(path: Path, arrays: Arrays) -> None:
    """A compressed npz, whole or not at all; its folder is made.

    Raises:
        OutputError: the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def arrays(path: Path, *names: str) -> Arrays:
    """The arrays of a sample, or those of `names` alone, which is faster.

    Raises:
        ArmError: it is neither a file nor in a shard, or is damaged.
    """
    try:
        with np.load(path if path.exists() else io.BytesIO(_member(path))) as file:
            return {name: file[name] for name in names or file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ArmError(f"{path}: damaged ({error}); check with `python -m training shards DIR --verify`") from error


def rigs(shards: Path) -> list[Path]:
    """Every `rig_<k>.npz`, in a stable order.

    Raises:
        ArmError: there is none.
    """
    return _found(shards, "rig_*.npz")


def rigs_of(folder: Path) -> list[Path]:
    """Every `rig_<k>.npz` of one object, whose folder this would be; in a stable order."""
    members = (_known.get(folder.parent) or members_of(folder.parent)).get(folder.name, {})
    return sorted({folder / name for name in fnmatch.filter(members, "rig_*.npz")}.union(folder.glob("rig_*.npz")))


def meshes(shards: Path) -> list[Path]:
    """The `mesh.npz` of every object, in a stable order.

    Raises:
        ArmError: there is none.
    """
    return _found(shards, "mesh.npz")


def read_mesh(path: Path) -> TriangleMesh:
    """The true surface in a `mesh.npz`, in the frame of the cameras; its vertices may be split at seams."""
    mesh = arrays(path, "vertices", "faces")
    return TriangleMesh(torch.from_numpy(mesh["vertices"]).float(), torch.from_numpy(mesh["faces"]).long())


def read_indexes(shards: Path) -> list[dict[str, Any]]:
    """The indexes of all finished shards of a folder, in order.

    Raises:
        ArmError: one is damaged.
    """
    return [read_index(path) for path in sorted(shards.glob(INDEXES))]


def read_index(path: Path) -> dict[str, Any]:
    """One shard's index, or the index.json of a folder of shards.

    Raises:
        ArmError: it is damaged.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ArmError(f"{path}: not a readable index ({error}); remove it with its tar, and render again") from error


def members_of(shards: Path) -> dict[str, dict[str, Place]]:
    """All members of a folder's tar shards, of each object by name; read anew."""
    _known[shards] = {
        record["key"]: {
            name: Place(shards / index["shard"], offset, size)
            for name, (offset, size) in record.get("members", {}).items()
        }
        for index in read_indexes(shards)
        for record in index["objects"]
    }
    return _known[shards]


def real_objects(data: Path | None) -> frozenset[str]:
    """Names of the scanned and measured objects of a data folder; none without a folder.

    They are few among many low-poly ones, and what users bring looks like them.

    Raises:
        ArmError: the folder has no manifest, or one that cannot be read.
    """
    if data is None:
        return frozenset()
    return frozenset(entry["id"] for entry in read_manifest(data)["objects"] if entry["set"] in ("gso", "pbr"))


def nothing_prepared(shards: Path) -> ArmError:
    """What a stage that learns at points says of a folder without an object to train on."""
    return ArmError(
        f"{shards}: no prepared object to train on; `python -m training prepare --shards {shards}`, or render more"
    )


def cameras(arrays: Arrays) -> tuple[Camera, ...]:
    """The cameras of one rig."""
    size = arrays["rgba"].shape[1]
    return tuple(
        Camera(torch.from_numpy(c2w), torch.from_numpy(K), size, size)
        for c2w, K in zip(arrays["c2w"], arrays["K"], strict=True)
    )


def _member(path: Path) -> bytes:
    """The bytes of a sample in a shard."""
    shards, key = path.parent.parent, path.parent.name
    place = _known.get(shards, {}).get(key, {}).get(path.name) or members_of(shards).get(key, {}).get(path.name)
    if place is None:
        raise ArmError(f"{path}: no such file, and no shard of {shards} holds it; render it")
    with place.shard.open("rb") as file:
        file.seek(place.offset)
        return file.read(place.size)


def _found(shards: Path, pattern: str) -> list[Path]:
    members = members_of(shards)
    inside = {shards / key / name for key, names in members.items() for name in fnmatch.filter(names, pattern)}
    found = sorted(inside.union(shards.glob(f"*/{pattern}")))
    if not found:
        raise ArmError(f"{shards}: no samples; make them with `python -m training render ASSETS --output {shards}`")
    return found
