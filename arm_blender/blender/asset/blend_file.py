"""A relightable asset as a .blend file of its own, written whole or not at all."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import bpy

from ...errors import OutputError
from ...machine.files import whole_file
from ...structures import RelightableAsset
from ..compat import reason, use_cycles, use_neutral_view
from ..console import without_chatter
from .asset_file import linked_asset
from .scene import build_object
from .studio import add_camera, bounding_sphere, light_softly, temporary_scene

_AZIMUTH_DEG, _ELEVATION_DEG = 30.0, 20.0
_SAMPLES = 64
_RESOLUTION = 1024


@without_chatter()
def save_blend(asset: RelightableAsset, path: Path | str, settings: Mapping[str, object]) -> None:
    """Write a .blend that opens with the asset in a lit scene with a camera, ready to render; images are packed.

    The open file keeps its scenes, selection and datablocks.

    Args:
        asset: mesh, atlas and maps.
        path: the file; an older one is replaced.
        settings: what the asset was made with; kept on the object.
    Raises:
        OutputError: the file cannot be written.
    """
    with temporary_scene(asset.name) as scene:
        shown = build_object(asset, settings, scene)
        center, radius = bounding_sphere([shown])
        add_camera(scene, center, radius, _AZIMUTH_DEG, _ELEVATION_DEG)
        light_softly(scene, center, radius)
        use_cycles(scene, _SAMPLES)
        use_neutral_view(scene)
        scene.render.resolution_x = scene.render.resolution_y = _RESOLUTION
        with written_by_blender(Path(path)) as partial:
            bpy.data.libraries.write(str(partial), {scene}, compress=True)


@without_chatter()
def kept_settings(path: Path) -> dict[str, object]:
    """What the asset in a .blend of ours was made with, as `save_blend` got it; empty where nothing is kept.

    Raises:
        ArmError: the file cannot be read.
    """
    with temporary_scene(path.stem) as scene:
        kept = [item["arm_settings"] for item in linked_asset(scene, path) if "arm_settings" in item]
    return json.loads(kept[0]) if kept else {}


@contextmanager
def written_by_blender(path: Path) -> Iterator[Path]:
    """As `whole_file`, for a file that one of Blender's own writers writes; its folder is made where it is missing.

    Raises:
        OutputError: the file cannot be written, in one line whatever Blender had to say.
    """
    path = path.absolute()  # Blender takes relative paths as relative to the open file.
    with whole_file(path) as partial:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            yield partial
        except (OSError, RuntimeError) as error:
            message = f"{path}: cannot be written ({reason(error)}); choose another place or free some"
            raise OutputError(message) from error
