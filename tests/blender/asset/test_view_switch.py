"""The view switch shows a map as it is, and the material renders as before once it is back at shaded."""

import numpy as np
import pytest

from arm_blender.structures import RelightableAsset

bpy = pytest.importorskip("bpy")
from arm_blender.blender.asset import view_switch  # noqa: E402
from arm_blender.blender.asset.scene import build_object  # noqa: E402
from arm_blender.blender.asset.studio import add_camera, bounding_sphere, light_softly  # noqa: E402
from arm_blender.blender.compat import use_cycles  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]

SIDE = 24


@pytest.fixture
def material(asset):
    return build_object(asset, {}).active_material


@pytest.fixture
def property_of_materials(empty_file):
    view_switch.register()
    yield
    view_switch.unregister()


def links(material) -> set[tuple[str, str, str, str]]:
    tree = material.node_tree
    return {(k.from_node.name, k.from_socket.identifier, k.to_node.name, k.to_socket.identifier) for k in tree.links}


def state(material):
    return links(material), sorted(node.name for node in material.node_tree.nodes), dict(material)


def rendered(tmp_path, name: str) -> np.ndarray:
    """(SIDE, SIDE, 4) linear floats of what the scene's camera sees, by Cycles with a fixed seed."""
    scene = bpy.context.scene
    scene.render.filepath = str(tmp_path / f"{name}.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    return np.array(image.pixels[:], dtype=np.float32).reshape(SIDE, SIDE, 4)


def studio(shown) -> None:
    scene = bpy.context.scene
    center, radius = bounding_sphere([shown])
    add_camera(scene, center, radius, 0.0, 60.0)
    light_softly(scene, center, radius)
    use_cycles(scene, 4, denoise=False)
    scene.render.resolution_x = scene.render.resolution_y = SIDE
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR", "32"


def test_shaded_renders_again_exactly_as_before_and_a_map_shows_its_numbers(
    make_mesh, make_plain_maps, property_of_materials, tmp_path
):
    maps = make_plain_maps((0.2, 0.5, 0.7), 0.25, 0.75)
    shown = build_object(RelightableAsset("ring", make_mesh(24, 12), maps), {})
    studio(shown)
    before = rendered(tmp_path, "before")
    for view, expected in (("albedo", (0.2, 0.5, 0.7)), ("roughness", (0.25,) * 3), ("metallic", (0.75,) * 3)):
        shown.active_material.arm_view = view
        picture = rendered(tmp_path, view)
        ring = np.abs(picture[..., :3] - np.array(expected)).max(axis=-1) < 3 / 255
        assert 0.2 < ring.mean() < 0.9, view
    shown.active_material.arm_view = "shaded"
    assert np.array_equal(rendered(tmp_path, "after"), before)


@pytest.mark.parametrize("way", [["albedo"], ["baked", "metallic", "roughness"], ["albedo", "albedo"]])
def test_nothing_of_the_switch_stays_in_the_material(material, way):
    before = state(material)
    for view in way:
        view_switch.show(material, view)
        output = material.node_tree.get_output_node("ALL").inputs["Surface"].links[0].from_node
        assert output.type == "EMISSION"
        assert output.inputs["Color"].links[0].from_node.name == view_switch.MAP_NODES[view]
    view_switch.show(material, "shaded")
    assert state(material) == before


def test_what_the_user_put_before_the_output_comes_back(material):
    tree = material.node_tree
    mix = tree.nodes.new("ShaderNodeMixShader")
    surface = tree.get_output_node("ALL").inputs["Surface"]
    tree.links.new(tree.nodes["Principled BSDF"].outputs["BSDF"], mix.inputs[2])
    tree.links.new(mix.outputs["Shader"], surface)
    before = state(material)
    view_switch.show(material, "albedo")
    view_switch.show(material, "shaded")
    assert state(material) == before


def test_a_material_without_an_output_or_a_surface_breaks_nothing(material):
    tree = material.node_tree
    tree.links.remove(tree.get_output_node("ALL").inputs["Surface"].links[0])
    before = state(material)
    view_switch.show(material, "baked")
    view_switch.show(material, "shaded")
    assert state(material) == before
    tree.nodes.remove(tree.get_output_node("ALL"))
    view_switch.show(material, "albedo")
    assert tree.nodes.get("ARM map view") is None


def test_an_unknown_view_is_refused(material):
    with pytest.raises(ValueError, match="normals"):
        view_switch.show(material, "normals")
