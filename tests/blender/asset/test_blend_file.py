"""A .blend holds the whole asset and opens ready to render; writing it leaves no trace; a GLB keeps mesh and maps."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from arm_blender.errors import OutputError
from arm_blender.knobs.finishes import PRESETS
from arm_blender.structures import Regions

bpy = pytest.importorskip("bpy")
from arm_blender.blender.asset.blend_file import save_blend  # noqa: E402
from arm_blender.blender.asset.scene import build_object  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]


def vertices(mesh) -> np.ndarray:
    flat = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def sample(image, uvs: np.ndarray) -> np.ndarray:
    """(P, 4) the texel that holds each of (P, 2) UVs, as stored."""
    flat = np.empty(len(image.pixels), dtype=np.float32)
    image.pixels.foreach_get(flat)
    pixels = flat.reshape(image.size[1], image.size[0], 4)
    column, row = (np.clip(uvs, 0, 0.9999) * image.size[:]).astype(int).T
    return pixels[row, column]


def everything() -> dict[str, list[str]]:
    kinds = ("scenes", "objects", "meshes", "materials", "images", "collections", "cameras", "lights", "worlds")
    return {kind: sorted(item.name for item in getattr(bpy.data, kind)) for kind in kinds}


def test_the_file_opens_with_the_asset_whole(asset, tmp_path):
    save_blend(asset, tmp_path / "ring.blend", {"seed": 5})
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "ring.blend"))
    opened = bpy.data.objects["ring"]
    assert opened.name in bpy.context.scene.objects
    assert np.array_equal(vertices(opened.data), asset.mesh.vertices.numpy())
    assert sorted(image.name for image in bpy.data.images if image.packed_file) == [
        f"ring {kind}" for kind in ("albedo", "baked", "metallic", "roughness")
    ]
    assert opened["arm_settings"] == '{"seed": 5}'


def test_the_opened_file_renders(asset, tmp_path):
    save_blend(asset, tmp_path / "ring.blend", {})
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "ring.blend"))
    scene = bpy.context.scene
    scene.render.resolution_percentage = 4
    scene.cycles.samples = 2
    scene.render.filepath = str(tmp_path / "render.png")
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    pixels = np.array(picture.pixels[:]).reshape(*picture.size, 4)[..., :3]
    center, corner = pixels[15:26, 15:26], pixels[:4, :4]
    assert corner.std(axis=(0, 1)).max() < 0.02, "the sky is even"
    assert corner.mean() > 0.2, "the world is lit"
    assert center.std() > 0.03, "the object is in the middle"


def test_the_open_file_stays_as_it_was(asset, tmp_path):
    bpy.ops.mesh.primitive_cube_add()
    cube, scene, before = bpy.context.object, bpy.context.scene, everything()
    save_blend(asset, tmp_path / "ring.blend", {})
    assert everything() == before
    assert (bpy.context.scene, bpy.context.object, list(bpy.context.selected_objects)) == (scene, cube, [cube])


def test_saving_twice_in_one_process_gives_the_same_names(asset, tmp_path):
    for name in ("first.blend", "second.blend"):
        save_blend(asset, tmp_path / name, {})
        with bpy.data.libraries.load(str(tmp_path / name)) as (held, _):
            assert "ring" in held.objects


def test_a_failed_write_is_one_line_and_leaves_nothing(asset, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    before = everything()
    for target in (blocked / "ring.blend", tmp_path):
        with pytest.raises(OutputError) as caught:
            save_blend(asset, target, {})
        assert str(target) in str(caught.value)
        assert "\n" not in str(caught.value)
    assert everything() == before
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert not list(tmp_path.parent.glob(f".{tmp_path.name}*"))


def test_a_glb_comes_back_with_the_same_vertices_and_maps(asset, tmp_path):
    build_object(asset, {})
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "ring.glb"), use_selection=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "ring.glb"))
    came_back = next(item for item in bpy.data.objects if item.type == "MESH")
    assert np.allclose(np.array(came_back.matrix_world), np.eye(4), atol=1e-6)

    distances = np.linalg.norm(vertices(came_back.data)[:, None] - asset.mesh.vertices.numpy()[None], axis=-1)
    assert distances.min(axis=1).max() < 1e-5 and distances.min(axis=0).max() < 1e-5

    images = {socket: image_behind(came_back.active_material, socket) for socket in ("Base Color", "Roughness")}
    uvs = np.random.default_rng(2).random((200, 2))
    column, row = (uvs * 16).astype(int).T
    linear = asset.maps.albedo.permute(1, 2, 0).numpy()[15 - row, column]
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(sample(images["Base Color"], uvs)[:, :3] - encoded).max() <= 1 / 255
    packed = sample(images["Roughness"], uvs)  # glTF: green is roughness, blue is metallic.
    assert np.abs(packed[:, 1] - asset.maps.roughness[0].numpy()[15 - row, column]).max() <= 1 / 255
    assert np.abs(packed[:, 2] - asset.maps.metallic[0].numpy()[15 - row, column]).max() <= 1 / 255


@pytest.mark.parametrize("value", [None, 0.4], ids=["a map", "one value"])
def test_a_glb_of_blender_s_own_has_the_prediction_and_not_the_numbers_of_the_regions(asset, tmp_path, value):
    """Its exporter knows no table of finishes, and takes the first image that it meets."""
    index = torch.ones(16, 16, dtype=torch.uint8)
    regions = Regions(index, (1.0,), ((0.5, 0.5, 0.5),), finishes={1: PRESETS["gold"]})
    maps = replace(asset.maps, regions=regions, **({} if value is None else {"roughness": value}))
    build_object(replace(asset, maps=maps), {})
    bpy.ops.export_scene.gltf(filepath=str(tmp_path / "ring.glb"), use_selection=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "ring.glb"))
    came_back = next(item for item in bpy.data.objects if item.type == "MESH")
    uvs = np.random.default_rng(2).random((200, 2))
    column, row = (uvs * 16).astype(int).T
    packed = sample(image_behind(came_back.active_material, "Roughness"), uvs)
    assert np.abs(packed[:, 1] - maps.image("roughness", 16)[0].numpy()[15 - row, column]).max() <= 1.5 / 255
    assert np.abs(packed[:, 2] - maps.metallic[0].numpy()[15 - row, column]).max() <= 1.5 / 255


def image_behind(material, socket: str):
    """The image whose colour reaches an input of the Principled BSDF, through whatever nodes."""
    surface = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    node = surface.inputs[socket].links[0].from_node
    while node.type != "TEX_IMAGE":
        node = next(i for i in node.inputs if i.is_linked).links[0].from_node
    return node.image
