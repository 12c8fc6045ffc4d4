"""An asset in a scene of our own: a copy of the user's object, or what a file holds."""

from pathlib import Path

import bpy

from ...errors import ArmError
from ..compat import reason

KINDS = (".blend", ".glb", ".gltf", ".usda", ".usdz", ".usd", ".usdc", ".obj")
"""Suffixes of the files that are read."""


def linked_asset(scene: bpy.types.Scene, source: bpy.types.Object | Path | str) -> list[bpy.types.Object]:
    """Puts an asset into `scene`.

    Args:
        source: a mesh object of the open file, which stays as it is, or a file of one of `KINDS`.
    Returns:
        its objects: one copy, or all of the file but cameras and lamps.
    Raises:
        ArmError: the file cannot be read, or is no asset.
    """
    return [_copied(scene, source)] if isinstance(source, bpy.types.Object) else _loaded(scene, Path(source))


def _copied(scene: bpy.types.Scene, source: bpy.types.Object) -> bpy.types.Object:
    """A copy that shares the mesh and the materials, so that the user's object is not moved."""
    copied = source.copy()
    copied.animation_data_clear()
    copied.parent = None
    copied.matrix_world = source.matrix_world
    copied.hide_render = False
    scene.collection.objects.link(copied)
    return copied


def _loaded(scene: bpy.types.Scene, path: Path) -> list[bpy.types.Object]:
    """The objects of a file but its cameras and lamps, linked to `scene`."""
    path = path.absolute()
    known = ", ".join(KINDS)
    if not path.is_file():
        raise ArmError(f"{path}: no such asset; give a file of {known}")
    if path.suffix.lower() not in KINDS:
        raise ArmError(f"{path}: not an asset; give a file of {known}")
    try:
        loaded = _appended(scene, path) if path.suffix.lower() == ".blend" else _imported(scene, path)
    except (OSError, RuntimeError) as error:
        raise ArmError(f"{path}: Blender cannot read this asset ({reason(error)}); generate it again") from error
    for item in [item for item in loaded if item.type in ("CAMERA", "LIGHT", "LIGHT_PROBE")]:
        loaded.remove(item)
        bpy.data.objects.remove(item)
    return loaded


def _appended(scene: bpy.types.Scene, path: Path) -> list[bpy.types.Object]:
    with bpy.data.libraries.load(str(path), link=False) as (available, wanted):
        wanted.objects = list(available.objects)
    loaded = [item for item in wanted.objects if item is not None]
    for item in loaded:
        scene.collection.objects.link(item)
    return loaded


def _imported(scene: bpy.types.Scene, path: Path) -> list[bpy.types.Object]:
    layer = scene.view_layers[0]
    with bpy.context.temp_override(
        scene=scene, view_layer=layer, collection=scene.collection, layer_collection=layer.layer_collection
    ):
        kind = path.suffix.lower()
        if kind in (".glb", ".gltf"):
            bpy.ops.import_scene.gltf(filepath=str(path))
        elif kind == ".obj":
            bpy.ops.wm.obj_import(filepath=str(path))
        else:
            bpy.ops.wm.usd_import(filepath=str(path))
    return list(scene.collection.all_objects)
