"""Tar shards as WebDataset reads them, made of rendered objects; whole or not at all.

`000000.tar` holds `<id>.mesh.npz`, `<id>.rig_<k>.npz` and `<id>.json` of each of its objects, one object after another.
`000000.json`, written after it, marks it as whole: its SHA-256, and of each object the source, where its members lie in
the tar, the seconds it took, or why it was dropped. `index.json` says how all of them were made.

An object is a *part* first, a tar of its own in `.parts/`; whoever is killed loses the object that it was rendering.
Objects go into shards in the order of the list, so that shards do not tell in how many processes they were made.
"""

import hashlib
import io
import json
import tarfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from arm_blender.errors import ArmError
from arm_blender.machine.files import clear_unfinished, only_writer, whole_file, write_json
from arm_blender.version import VERSION

from .shards import INDEXES, Arrays, read_index, read_indexes

CAMERA = (
    "OpenGL: c2w is camera to world, rigid, looks along -Z with +Y up; world right-handed, Z up, the object's longest "
    "side is 2, centred; K in pixels, centres at +0.5, row 0 on top; depth along the view axis, world units, float16, "
    "infinity is background; normal in world space, int8 / 127; colour and albedo sRGB, straight alpha"
)
"""The convention of all arrays, repeated in every shard."""

PARTS = ".parts"

FORMAT = "arm-shards-2"
"""Raised where the same settings render something else than before, too: a folder never holds both."""


@contextmanager
def writing(output: Path, settings: dict[str, Any]) -> Iterator[None]:
    """Make or take up a folder of shards, which no other run may write into until the block ends.

    What killed processes left half-done is taken away. The tasks of a run write inside of its block: they have no lock
    of their own, wherever they run.

    Args:
        settings: JSON, whatever decides what the shards hold.
    Raises:
        ArmError: it holds shards that were made otherwise.
        OutputError: another run writes into it, or it cannot be written.
    """
    with only_writer(output / PARTS):
        _take_up(output, settings)
        yield


def _take_up(output: Path, settings: dict[str, Any]) -> None:
    """What killed processes left goes, and the index says how the shards are made."""
    head = {"format": FORMAT, "version": VERSION, "camera": CAMERA, "settings": settings}
    place = output / "index.json"
    if place.exists():
        before = read_index(place)
        changed = sorted(
            name
            for name in {*settings, *before.get("settings", {})}
            if before.get("settings", {}).get(name) != settings.get(name)
        )
        if before.get("format") != FORMAT or changed:
            what = ", ".join(changed) or "the format"
            raise ArmError(f"{output}: its shards were made with other settings ({what}); choose another --output")
    else:
        write_json(place, head)
    clear_unfinished(output)
    finished = {record["key"] for index in read_indexes(output) for record in index["objects"]}
    for path in (output / PARTS).iterdir():
        if path.match(".*.part.*") or path.stem in finished:
            path.unlink(missing_ok=True)


def finished(output: Path) -> tuple[set[str], set[str]]:
    """The objects in shards, and those that are parts."""
    packed = {record["key"] for index in read_indexes(output) for record in index["objects"]}
    return packed, {path.stem for path in (output / PARTS).glob("[!.]*.json")}


def save_part(output: Path, record: dict[str, Any], files: dict[str, Arrays], seconds: dict[str, float]) -> None:
    """One object, rendered or dropped.

    Args:
        record: JSON; its "key" names the object, "dropped" says why it was not rendered.
        files: names and arrays of its npz; none where it was dropped.
        seconds: what it took; in the index only, so that the same objects make the same tar.
    Raises:
        OutputError: it cannot be written.
    """
    key, place = record["key"], output / PARTS
    if files:
        with whole_file(place / f"{key}.tar") as temporary, tarfile.open(temporary, "w") as tar:
            for name, arrays in files.items():
                buffer = io.BytesIO()
                np.savez_compressed(buffer, **arrays)
                _add(tar, f"{key}.{name}", buffer.getvalue())
            told = record | {"camera": CAMERA, "version": VERSION}
            _add(tar, f"{key}.json", json.dumps(told, ensure_ascii=False, sort_keys=True).encode())
    write_json(place / f"{key}.json", record | {"seconds": seconds})


def pack(output: Path, keys: Sequence[str]) -> Path | None:
    """Parts become the next shard, in the order given; returns its tar, None where all of them were dropped.

    Raises:
        OutputError: it cannot be written.
    """
    name = f"{len(list(output.glob(INDEXES))):06d}"
    parts, tar_path = output / PARTS, output / f"{name}.tar"
    records = [read_index(parts / f"{key}.json") for key in keys]
    rendered = [record for record in records if not record.get("dropped")]
    index: dict[str, Any] = {"shard": tar_path.name if rendered else None, "camera": CAMERA, "version": VERSION}
    if rendered:
        with whole_file(tar_path) as temporary:
            with tarfile.open(temporary, "w") as tar:
                for record in rendered:
                    with tarfile.open(parts / f"{record['key']}.tar") as part:
                        for member in part:
                            file = part.extractfile(member)
                            assert file is not None  # `save_part` adds nothing but files.
                            _add(tar, member.name, file.read())
            _locate(temporary, rendered)
            index |= {"sha256": checksum(temporary), "bytes": temporary.stat().st_size}
    # Last: only now is the shard read.
    write_json(output / f"{name}.json", index | {"objects": records})
    for key in keys:
        for suffix in ("tar", "json"):
            (parts / f"{key}.{suffix}").unlink(missing_ok=True)
    return tar_path if rendered else None


def verify(output: Path) -> list[str]:
    """The names of shards that are missing or not what their index says."""
    wrong = []
    for index in read_indexes(output):
        if index["shard"] is not None:
            path = output / index["shard"]
            if not path.is_file() or checksum(path) != index["sha256"]:
                wrong.append(index["shard"])
    return wrong


def checksum(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _locate(path: Path, records: list[dict[str, Any]]) -> None:
    """Tell each record where its npz lie in the tar, so that one is read without the others."""
    by_key = {record["key"]: record for record in records}
    with tarfile.open(path) as tar:
        for member in tar:
            key, _, name = member.name.partition(".")
            if name.endswith(".npz"):
                by_key[key].setdefault("members", {})[name] = [member.offset_data, member.size]


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    """A member without owner and time: the same content makes the same tar."""
    member = tarfile.TarInfo(name)
    member.size = len(content)
    tar.addfile(member, io.BytesIO(content))
