"""What regions are set to renders, is exported and comes back from a file; reset, the material is what it was."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from arm_blender.knobs.finishes import PRESETS, Finish
from arm_blender.structures import RelightableAsset
from arm_blender.uv.finish import finished

bpy = pytest.importorskip("bpy")
from arm_blender.blender.asset.finish_nodes import GROUP, finishes, set_finish  # noqa: E402
from arm_blender.blender.asset.object_asset import asset_from_object  # noqa: E402
from arm_blender.blender.asset.scene import build_object  # noqa: E402
from arm_blender.blender.compat import use_cycles, use_exr  # noqa: E402

SIDE = 16

pytestmark = pytest.mark.blender

CHROME, GOLD, RUBBER = (PRESETS[name] for name in ("chrome", "gold", "rubber"))
NAMELESS = Finish(0.3, 0.75)
LEFT, RIGHT = slice(0, SIDE // 2), slice(SIDE // 2, SIDE)
UPPER, LOWER = slice(0, SIDE // 4), slice(SIDE // 4, SIDE)


def state(material) -> tuple:
    tree = material.node_tree
    links = {(k.from_node.name, k.from_socket.identifier, k.to_node.name, k.to_socket.identifier) for k in tree.links}
    surface = tree.nodes["Principled BSDF"]
    values = [surface.inputs[name].default_value for name in ("Roughness", "Metallic")]
    return links, sorted(node.name for node in tree.nodes), values


def rendered(material, view: str, folder) -> np.ndarray:
    """(SIDE, SIDE, 3) what Cycles makes of a view of the square seen from above, row 0 on top: one pixel a texel."""
    scene = bpy.context.scene
    material.arm_view = view
    if scene.camera is None:
        lens = bpy.data.cameras.new("above")
        lens.type, lens.ortho_scale = "ORTHO", 2.0
        scene.camera = bpy.data.objects.new("above", lens)
        scene.camera.location = (0.0, 0.0, 3.0)
        scene.collection.objects.link(scene.camera)
        use_cycles(scene, 1, denoise=False)
        scene.cycles.pixel_filter_type = "BOX"
        scene.cycles.filter_width = 0.01
        scene.render.resolution_x = scene.render.resolution_y = SIDE
        use_exr(scene)
        for node in material.node_tree.nodes:
            if node.type == "TEX_IMAGE":
                node.interpolation = "Closest"
    scene.render.filepath = str(folder / f"{view}.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath, check_existing=False)
    pixels = np.array(image.pixels[:], dtype=np.float32).reshape(SIDE, SIDE, 4)[::-1, :, :3]
    bpy.data.images.remove(image)
    return pixels


@pytest.mark.parametrize("finish", [GOLD, RUBBER, NAMELESS], ids=["gold", "rubber", "a nameless metal"])
def test_it_renders_what_is_exported_and_the_rest_as_predicted(shown, maps, tmp_path, finish):
    """Of a nameless metal the base colour is made of the views, texel by texel."""
    material = shown.active_material
    set_finish(material, 2, finish)
    wanted = finished(replace(maps, regions=replace(maps.regions, finishes={2: finish})))
    for view in ("albedo", "roughness", "metallic"):
        picture = rendered(material, view, tmp_path)
        expected = getattr(wanted, view).expand(3, -1, -1).permute(1, 2, 0).numpy()
        assert np.abs(picture - expected).max() < 8 / 255, view
        if view != "albedo":
            assert np.abs(picture[LOWER, RIGHT] - getattr(finish, view)).max() < 1e-4, view
    if finish.f0 is not None:
        assert np.abs(rendered(material, "albedo", tmp_path)[LOWER, RIGHT] - finish.f0).max() < 1e-4
    assert not torch.equal(wanted.metallic, maps.metallic)


def test_every_number_reaches_its_own_step(shown, tmp_path):
    """Eight regions of eight roughnesses, in columns of two texels."""
    material = shown.active_material
    image = material.node_tree.nodes["Regions"].image
    numbers = np.repeat(np.arange(1, 9), 2)
    grey = np.ones((SIDE, SIDE, 4), dtype=np.float32)
    grey[..., :3] = ((numbers + 0.5) / 9.0)[None, :, None]
    image.pixels.foreach_set(grey.ravel())
    image.update()
    for number in range(1, 9):
        set_finish(material, number, Finish(number / 10.0, 0.0))
    assert rendered(material, "roughness", tmp_path)[5, :, 0] == pytest.approx(numbers / 10.0, abs=1e-4)


def test_regions_show_in_the_colors_of_their_swatches_and_the_chosen_one_orange(shown, tmp_path):
    orange = [0.85, 0.12, 0.0]
    picture = rendered(shown.active_material, "regions", tmp_path)
    assert picture[-1, 0] == pytest.approx(orange, abs=1e-4)
    assert picture[-1, -1] == pytest.approx([0.1, 0.4, 0.9], abs=1e-4)
    assert picture[0].max() == 0.0
    shown.active_material.arm_region = 2
    picture = rendered(shown.active_material, "regions", tmp_path)
    assert picture[-1, 0] == pytest.approx([0.8, 0.2, 0.1], abs=1e-4)
    assert picture[-1, -1] == pytest.approx(orange, abs=1e-4)
    shown.active_material.arm_view = "shaded"
    assert [node.name for node in shown.active_material.node_tree.nodes if node.type == "VALTORGB"] == []


@pytest.mark.parametrize("finish", [CHROME, RUBBER, NAMELESS])
def test_reset_leaves_nothing(shown, finish):
    material = shown.active_material
    before = state(material)
    set_finish(material, 1, finish)
    set_finish(material, 2, CHROME)
    assert finishes(material) == {1: finish, 2: CHROME}
    set_finish(material, 1, None)
    assert finishes(material) == {2: CHROME}
    set_finish(material, 2, None)
    assert state(material) == before and not bpy.data.node_groups


def test_without_a_metal_the_albedo_is_not_led_through_the_table(shown):
    set_finish(shown.active_material, 1, RUBBER)
    surface = shown.active_material.node_tree.nodes["Principled BSDF"]
    sources = [surface.inputs[name].links[0].from_node.name for name in ("Base Color", "Roughness", "Metallic")]
    assert sources == ["Albedo", GROUP, GROUP]


def test_a_constant_stays_the_value_of_other_regions_and_comes_back(empty_file, tile):
    constant = replace(tile.maps, roughness=0.4, metallic=0.0)
    shown = build_object(RelightableAsset("tile", tile.mesh, constant), {})
    material = shown.active_material
    before = state(material)
    set_finish(material, 2, CHROME)
    made = asset_from_object(shown).maps
    assert (made.roughness, made.metallic) == (pytest.approx(0.4), 0.0)
    set_finish(material, 2, None)
    assert state(material) == before and "Roughness, one value" not in bpy.data.images
    assert asset_from_object(shown).maps.roughness == pytest.approx(0.4)


def test_nodes_of_the_users_own_stay_where_they_were(shown):
    tree = shown.active_material.node_tree
    surface, gamma = tree.nodes["Principled BSDF"], tree.nodes.new("ShaderNodeGamma")
    tree.links.new(tree.nodes["Albedo"].outputs["Color"], gamma.inputs["Color"])
    tree.links.new(gamma.outputs["Color"], surface.inputs["Base Color"])
    before = state(shown.active_material)
    set_finish(shown.active_material, 1, CHROME)
    assert tree.nodes[GROUP].inputs["Base Color"].links[0].from_node == gamma
    set_finish(shown.active_material, 1, None)
    assert state(shown.active_material) == before


def test_a_copy_of_the_material_has_a_table_of_its_own(shown):
    set_finish(shown.active_material, 1, CHROME)
    copied = shown.active_material.copy()
    set_finish(copied, 1, RUBBER)
    assert finishes(shown.active_material) == {1: CHROME}
    assert finishes(copied) == {1: RUBBER}
    set_finish(copied, 1, None)
    assert finishes(shown.active_material) == {1: CHROME}


def test_it_is_in_the_file(shown, tmp_path):
    set_finish(shown.active_material, 2, CHROME)
    path = str(tmp_path / "tile.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    opened = bpy.data.objects["tile"].active_material
    assert finishes(opened) == {2: CHROME}


def test_a_result_with_finishes_comes_with_them_and_goes_with_them(empty_file, tile):
    set_maps = replace(tile.maps, regions=replace(tile.maps.regions, finishes={1: NAMELESS, 2: GOLD}))
    shown = build_object(RelightableAsset("tile", tile.mesh, set_maps), {})
    assert finishes(shown.active_material) == {1: NAMELESS, 2: GOLD}
    made = asset_from_object(shown).maps
    assert torch.equal(made.regions.index, tile.maps.regions.index)
    for name in ("area", "swatch", "light", "finishes"):
        assert getattr(made.regions, name) == getattr(set_maps.regions, name), name
    for name in ("albedo", "roughness", "metallic", "baked"):
        assert (getattr(made, name) - getattr(tile.maps, name)).abs().max() < 4 / 255, f"{name} is as predicted"
