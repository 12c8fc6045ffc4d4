"""What objects stand on: the textures of a data folder, split into those of training and those of evaluation."""

import zlib
from pathlib import Path
from typing import Literal

from arm_blender.errors import ArmError

from ..manifest import read_manifest

_SHARES, _HELD_OUT = 6, 1
"""One texture in six is ground for evaluation alone, where a manifest does not split its textures."""


def ground_textures(data: Path, split: Literal["train", "eval"]) -> list[Path]:
    """Base colours that grounds are made of, in the order of their names.

    Args:
        data: folder with `manifest.json`.
    Raises:
        ArmError: there are none of that split.
    """
    found = {}
    for entry in read_manifest(data)["textures"]:
        held_out = zlib.crc32(entry["id"].encode()) % _SHARES == _HELD_OUT
        if entry.get("split", "eval" if held_out else "train") == split and "basecolor" in entry["maps"]:
            found[entry["id"]] = data / entry["maps"]["basecolor"]
    if not found:
        raise ArmError(f"{data}: no texture of the split {split} for a ground; give a data folder that has some")
    return [found[name] for name in sorted(found)]
