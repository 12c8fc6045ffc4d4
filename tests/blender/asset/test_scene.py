"""An asset becomes an object: the same mesh, welded, with UVs on corners, without touching the user's work."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from arm_blender.structures import UvMesh

pytest.importorskip("bpy")
from arm_blender.blender.asset.scene import build_mesh, build_object, replace_maps  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]


def read(collection, attribute: str, width: int, dtype=np.float32) -> np.ndarray:
    flat = np.empty(len(collection) * width, dtype=dtype)
    collection.foreach_get(attribute, flat)
    return flat.reshape(-1, width)


def corner_uvs(mesh) -> np.ndarray:
    flat = np.empty(2 * len(mesh.loops), dtype=np.float32)
    mesh.uv_layers[0].uv.foreach_get("vector", flat)
    return flat.reshape(-1, 3, 2)


def test_the_mesh_keeps_vertices_faces_and_corner_uvs(asset):
    built = build_object(asset, {}).data
    assert np.array_equal(read(built.vertices, "co", 3), asset.mesh.vertices.numpy())
    assert np.array_equal(read(built.polygons, "vertices", 3, np.int32), asset.mesh.faces.numpy())
    assert np.array_equal(corner_uvs(built), asset.mesh.uvs[asset.mesh.face_uvs].numpy())


def test_a_large_mesh_is_welded_across_its_seams(make_mesh):
    built = build_mesh("large", make_mesh(400, 250))
    assert len(built.polygons) == 200_000
    uses = np.bincount(read(built.loops, "edge_index", 1, np.int32).ravel(), minlength=len(built.edges))
    assert (uses == 2).all(), "a closed surface has two faces at every edge, also along the seams of the atlas"
    assert len(built.vertices) - len(built.edges) + len(built.polygons) == 0, "Euler characteristic of a torus"


def test_normals_are_smooth_also_at_seams(make_mesh):
    mesh = make_mesh(64, 48)
    built = build_mesh("smooth", mesh)
    corner_normals = read(built.corner_normals, "vector", 3).reshape(-1, 3, 3)
    points = mesh.vertices[mesh.faces].numpy()
    core = points * [1, 1, 0]
    expected = points - 0.7 * core / np.linalg.norm(core, axis=-1, keepdims=True)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    assert ((corner_normals * expected).sum(-1) > 0.999).all()


def test_a_degenerate_face_goes_without_shifting_the_uvs_of_the_others(make_mesh):
    good = make_mesh(6, 5)
    faces, face_uvs = good.faces.clone(), good.face_uvs
    faces[7] = faces[7, 0]
    built = build_mesh("damaged", UvMesh(good.vertices, faces, good.uvs, face_uvs, 1))
    kept = torch.arange(len(faces)) != 7
    assert np.array_equal(read(built.polygons, "vertices", 3, np.int32), faces[kept].numpy())
    assert np.array_equal(corner_uvs(built), good.uvs[face_uvs[kept]].numpy())


def test_the_object_stands_alone_selected_in_its_own_collection(asset, empty_file):
    bpy = empty_file
    bpy.ops.object.empty_add()
    built = build_object(asset, {"seed": 3})
    assert [c.name for c in built.users_collection] == ["ring"]
    assert bpy.data.collections["ring"] in list(bpy.context.scene.collection.children)
    assert bpy.context.view_layer.objects.active == built
    assert list(bpy.context.selected_objects) == [built]
    assert json.loads(built["arm_settings"])["seed"] == 3


@pytest.mark.parametrize("mode", ["EDIT", "SCULPT"])
def test_in_another_mode_the_users_work_goes_on(asset, empty_file, mode):
    bpy = empty_file
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    bpy.ops.object.mode_set(mode=mode)
    built = build_object(asset, {})
    assert cube.mode == mode
    assert bpy.context.object == cube
    assert list(bpy.context.selected_objects) == [cube]
    assert built.name in bpy.context.scene.objects


def test_two_of_one_name_share_nothing(asset):
    first, second = build_object(asset, {}), build_object(asset, {})
    assert first.data != second.data
    assert first.active_material != second.active_material


def names(blocks) -> list[str]:
    return sorted(block.name for block in blocks)


def test_new_maps_take_the_place_of_the_old_ones_and_nothing_else_changes(asset, empty_file, make_plain_maps):
    bpy = empty_file
    built = build_object(asset, {"seed": 1})
    built.location, mesh, before = (1.0, 2.0, 3.0), built.data, names(bpy.data.images)
    replace_maps(built, replace(asset.maps, albedo=1.0 - asset.maps.albedo), {"seed": 2})
    assert (built.data, tuple(built.location)) == (mesh, (1.0, 2.0, 3.0))
    assert (names(bpy.data.materials), names(bpy.data.images)) == (["ring"], before)
    assert json.loads(built["arm_settings"])["seed"] == 2
    texel = bpy.data.images["ring albedo"].pixels[0]
    linear = 1.0 - float(asset.maps.albedo[0, -1, 0])
    assert texel == pytest.approx(1.055 * linear ** (1 / 2.4) - 0.055, abs=1 / 255)


@pytest.mark.parametrize("case", ["shared", "own"])
def test_a_material_that_is_not_only_ours_stays(asset, empty_file, case):
    bpy = empty_file
    built = build_object(asset, {})
    kept = built.active_material
    if case == "shared":
        build_object(asset, {}).data.materials[0] = kept
    else:
        kept = bpy.data.materials.new("paint")
        built.data.materials[0] = kept
    name = kept.name
    replace_maps(built, asset.maps, {})
    assert built.active_material != kept and bpy.data.materials[name] == kept


def test_an_object_without_a_material_gets_one(asset):
    built = build_object(asset, {})
    built.data.materials.clear()
    replace_maps(built, asset.maps, {})
    assert built.active_material is not None
