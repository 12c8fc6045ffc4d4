"""The environment maps that Blender ships, and those that a user names."""

import functools
from pathlib import Path

import bpy

from ...errors import InputImageError


@functools.cache
def shipped_environments() -> dict[str, Path]:
    """The CC0 maps that come with Blender for its viewport, by name, sorted; read once, for menus are drawn often."""
    folder = Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world"
    return {path.stem: path for path in sorted(folder.glob("*.exr"))}


def environment_path(environment: str | Path) -> Path:
    """The file of an environment map: a path, or the name of one that Blender ships, such as "forest".

    Raises:
        InputImageError: neither is there.
    """
    shipped = shipped_environments()
    for candidate in (Path(environment), shipped.get(str(environment))):
        if candidate is not None and candidate.is_file():
            return candidate.resolve()
    names = ", ".join(shipped)
    raise InputImageError(f"{environment}: no such environment map; give a .hdr or .exr file, or one of: {names}")
