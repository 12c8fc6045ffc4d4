"""A relightable asset as an object of the open file."""

import json
from collections.abc import Mapping
from typing import Literal

import bpy
import numpy as np

from ..structures import RelightableAsset, UvMesh
from ..version import VERSION
from .material_nodes import UV_MAP, build_material

Placement = Literal["cameras", "ground"]


def build_object(
    asset: RelightableAsset, settings: Mapping[str, object], scene: bpy.types.Scene | None = None
) -> bpy.types.Object:
    """Add an asset to a scene: a mesh object with its material, in a collection of its own.

    The object is made active and alone selected, unless the user is in another mode than Object: then mode, active
    object and selection stay as they are.

    Args:
        asset: mesh, atlas and maps.
        settings: what it was made with; kept on the object as JSON (`arm_settings`, beside `arm_version`).
        scene: where it goes; the scene of the context by default.
    """
    scene = bpy.context.scene if scene is None else scene
    mesh = build_mesh(asset.name, asset.mesh)
    created = bpy.data.objects.new(asset.name, mesh)
    mesh.materials.append(build_material(created.name, asset.maps))
    created["arm_version"] = VERSION
    created["arm_settings"] = json.dumps(dict(settings), default=str, sort_keys=True)
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


def place(placed: bpy.types.Object, where: Placement) -> None:
    """Move an object that `build_object` made.

    Args:
        where: "cameras" leaves it in the frame of the views' cameras; "ground" stands it on z = 0 with the middle
            of its bounding box over or under the 3D cursor.
    """
    if where == "cameras":
        placed.location = (0.0, 0.0, 0.0)
        return
    corners = np.array(placed.bound_box)  # (8, 3) in the object's space
    low, high = corners.min(axis=0), corners.max(axis=0)
    cursor = bpy.context.scene.cursor.location
    middle = (low + high) / 2.0
    placed.location = (cursor.x - middle[0], cursor.y - middle[1], -low[2])


def _select_alone(chosen: bpy.types.Object) -> None:
    for other in bpy.context.selected_objects:
        other.select_set(False)
    chosen.select_set(True)
    bpy.context.view_layer.objects.active = chosen
