"""A relightable asset as an object of the open file."""

import json
from collections.abc import Mapping

import bpy
import numpy as np

from ...structures import MaterialMaps, RelightableAsset, UvMesh
from ...version import VERSION
from ..compat import shader_tree
from .finish_nodes import finish_node
from .material_nodes import NORMAL, UV_MAP, build_material
from .predicted_light import keep_light


def build_object(
    asset: RelightableAsset, settings: Mapping[str, object], scene: bpy.types.Scene | None = None
) -> bpy.types.Object:
    """Add an asset to a scene: a mesh object with its material, in a collection of its own.

    The object is made active and alone selected, unless the user is in another mode than Object: then mode, active
    object and selection stay as they are.

    Args:
        asset: mesh, atlas and maps.
        settings: what it was made with (`AssetRecord.as_json`), kept on the object as `arm_settings`, beside
            `arm_version` and the light of the views.
        scene: where it goes; the scene of the context by default.
    """
    scene = bpy.context.scene if scene is None else scene
    mesh = build_mesh(asset.name, asset.mesh)
    created = bpy.data.objects.new(asset.name, mesh)
    mesh.materials.append(build_material(created.name, asset.maps))
    keep_light(created, asset.maps.light)
    _keep_settings(created, settings)
    collection = bpy.data.collections.new(asset.name)
    collection.objects.link(created)
    scene.collection.children.link(collection)
    if scene == bpy.context.scene and bpy.context.mode == "OBJECT":
        _select_alone(created)
    return created


def build_mesh(name: str, mesh: UvMesh) -> bpy.types.Mesh:
    """A welded, smoothly shaded mesh whose UVs lie on corners; no Python loop runs over its elements."""
    vertices = mesh.vertices.detach().cpu().numpy().astype(np.float32, copy=False)
    faces = mesh.faces.cpu().numpy().astype(np.int32)
    corner_uvs = mesh.uvs.detach().cpu().numpy().astype(np.float32, copy=False)[mesh.face_uvs.cpu().numpy()]
    corners = faces.size

    created = bpy.data.meshes.new(name)
    created.vertices.add(len(vertices))
    created.vertices.foreach_set("co", vertices.ravel())
    created.loops.add(corners)
    created.loops.foreach_set("vertex_index", faces.ravel())
    created.polygons.add(len(faces))
    created.polygons.foreach_set("loop_start", np.arange(0, corners, 3, dtype=np.int32))
    layer = created.uv_layers.new(name=UV_MAP, do_init=False)
    layer.uv.foreach_set("vector", corner_uvs.ravel())
    created.update(calc_edges=True)
    created.validate()  # After the UVs, so that they go along where a degenerate face is dropped.
    created.shade_smooth()
    return created


def replace_maps(shown: bpy.types.Object, maps: MaterialMaps, settings: Mapping[str, object]) -> None:
    """Give an object that `build_object` made other maps on the same atlas; mesh, place and selection stay.

    So does a normal map, which belongs to the mesh.

    The object gets a new material in its first slot. The old one goes with its images, unless it is used elsewhere or
    the user's own.

    Args:
        shown: the object.
        maps: of its atlas.
        settings: what they were made with, kept as by `build_object`.
    """
    if not shown.material_slots:
        shown.data.materials.append(None)
    slot = shown.material_slots[0]
    old = slot.material
    images, groups, normal = set(), set(), None
    replaced = old is not None and "arm_maps" in old and old.users == 1
    if replaced:
        textures = (node for node in shader_tree(old).nodes if node.type == "TEX_IMAGE")
        images = {texture.image for texture in textures if texture.image is not None}
        table = finish_node(shader_tree(old))
        groups = {table.node_tree} if table is not None else set()
        kept = shader_tree(old).nodes.get(NORMAL)
        normal = kept.image if kept is not None else None
        for block in {old, *images} - {normal}:
            block.name = f"old {block.name}"  # The new ones take their names.
    slot.material = build_material(shown.name, maps, normal)
    keep_light(shown, maps.light)
    _keep_settings(shown, settings)
    if replaced:
        bpy.data.materials.remove(old)
        bpy.data.batch_remove({block for block in images | groups if not block.users})


def _keep_settings(made: bpy.types.Object, settings: Mapping[str, object]) -> None:
    made["arm_version"] = VERSION
    made["arm_settings"] = json.dumps(dict(settings))


def _select_alone(chosen: bpy.types.Object) -> None:
    for other in bpy.context.selected_objects:
        other.select_set(False)
    chosen.select_set(True)
    bpy.context.view_layer.objects.active = chosen
