"""The data folder's manifest.json: which objects, textures and environment maps there are, and of which split."""

import json
from pathlib import Path
from typing import Any

from arm_blender.errors import ArmError


def read_manifest(data: Path | None) -> dict[str, list[dict[str, Any]]]:
    """The entries under "objects", "textures" and "hdris"; empty where the manifest has none of the last two.

    Args:
        data: the folder; None where neither --data nor ARM_DATA names one.
    Raises:
        ArmError: there is no folder, or its manifest cannot be read.
    """
    if data is None:
        raise ArmError("no data folder; give --data DIR or set ARM_DATA")
    path = data / "manifest.json"
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ArmError(f"{path}: not a readable manifest ({error}); give the data folder with --data") from error
    if not isinstance(manifest, dict) or not isinstance(manifest.get("objects"), list):
        raise ArmError(f"{path}: holds no list of objects; give the data folder with --data")
    return {"textures": [], "hdris": [], **manifest}
