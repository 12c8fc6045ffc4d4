"""The objects to render: files in any folder, or the entries of a data folder's manifest."""

import os
import re
import zlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from arm_blender.errors import ArmError

FORMATS = (".glb", ".gltf", ".obj", ".fbx", ".usd", ".usda", ".usdc", ".usdz")
"""What Blender imports without running code of the file; a .blend may hold scripts, and is not among them."""


@dataclass(frozen=True)
class Asset:
    """One object's file."""

    key: str
    """Names the object in shards; letters, digits, `_` and `-`, since WebDataset ends a key at the first dot."""
    path: str
    """Where the file is."""
    source: str
    """The file's path in its folder, for the index."""
    own_finish: bool | None = None
    """Whether roughness and metallic of the file are to be believed; None asks the file for a map."""
    up: Literal["Y", "Z"] = "Y"
    """Of an OBJ, which does not say it."""


def find_assets(folder: Path, obj_up: Literal["Y", "Z"] = "Y") -> list[Asset]:
    """Every file of a known format in a folder and its folders, in the order of rendering.

    Raises:
        ArmError: the folder is none, or holds no such file.
    """
    if not folder.is_dir():
        raise ArmError(f"{folder}: no folder; give one with objects ({', '.join(FORMATS)})")
    found = []
    for place, _, names in os.walk(folder):
        found += [Path(place, name) for name in names if name.lower().endswith(FORMATS)]
    if not found:
        raise ArmError(f"{folder}: holds no object; known formats are {', '.join(FORMATS)}")
    sources = [path.relative_to(folder).as_posix() for path in sorted(found)]
    keys = [_key(source.rpartition(".")[0]) for source in sources]
    # Where files differ in their suffix alone, or in what a key cannot hold, the whole path tells them apart.
    doubled = {key for key, count in Counter(keys).items() if count > 1}
    return in_order(
        Asset(
            f"{key}-{zlib.crc32(source.encode()):08x}" if key in doubled else key,
            str(folder / source),
            source,
            up=obj_up,
        )
        for key, source in zip(keys, sources, strict=True)
    )


def manifest_assets(entries: Iterable[dict[str, Any]], data: Path) -> list[Asset]:
    """The objects of a manifest, in the order of rendering; `pbr` objects keep their own roughness and metallic."""
    return in_order(
        Asset(
            _key(entry["id"]),
            str(data / entry["main"]),
            entry["main"],
            own_finish=entry["set"] == "pbr",
            up="Z" if entry["set"] == "gso" else "Y",  # Google Scanned Objects stand on Z.
        )
        for entry in entries
    )


def in_order(assets: Iterable[Asset]) -> list[Asset]:
    """A fixed mixture, so that any prefix, and any shard, is a fair sample."""
    return sorted(assets, key=lambda asset: (zlib.crc32(asset.key.encode()), asset.key))


def _key(name: str) -> str:
    return re.sub(r"[^\w-]", "_", name, flags=re.ASCII)
