"""Maps become images without loss beyond 8 bits, and one material that uses them."""

import numpy as np
import pytest
import torch

from arm_blender.structures import MaterialMaps

pytest.importorskip("bpy")
from arm_blender.blender.asset.material_nodes import build_material, image_from_map  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]


def stored(image) -> np.ndarray:
    """(H, W, 3) as the image's file has it, top row first."""
    flat = np.empty(len(image.pixels), dtype=np.float32)
    image.pixels.foreach_get(flat)
    return flat.reshape(image.size[1], image.size[0], 4)[::-1, :, :3]


def source(material, socket: str):
    links = material.node_tree.nodes["Principled BSDF"].inputs[socket].links
    return links[0].from_node if links else None


def test_numbers_come_back_within_half_a_step(maps):
    image = image_from_map("roughness", maps.roughness, "Non-Color")
    assert image.colorspace_settings.name == "Non-Color"
    assert np.abs(stored(image) - maps.roughness[0, :, :, None].numpy()).max() <= 0.5001 / 255


def test_colors_are_stored_in_srgb_with_the_first_row_on_top(maps):
    image = image_from_map("albedo", maps.albedo, "sRGB")
    assert image.colorspace_settings.name == "sRGB"
    linear = maps.albedo.permute(1, 2, 0).numpy().astype(np.float64)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(stored(image) - encoded).max() <= 0.5001 / 255


def test_maps_feed_the_principled_bsdf(maps):
    material = build_material("mug", maps)
    assert source(material, "Base Color").image.name == "mug albedo"
    assert source(material, "Base Color").image.colorspace_settings.name == "sRGB"
    for socket in ("Roughness", "Metallic"):
        image = source(material, socket).image
        assert image.name == f"mug {socket.lower()}"
        assert image.colorspace_settings.name == "Non-Color"


def test_the_baked_color_is_kept_but_lights_nothing(maps):
    material = build_material("mug", maps)
    nodes = [n for n in material.node_tree.nodes if n.type == "TEX_IMAGE" and n.image.name == "mug baked"]
    assert len(nodes) == 1
    assert "Baked" in nodes[0].label
    assert not any(output.is_linked for output in nodes[0].outputs)


def test_every_image_is_packed(maps, empty_file):
    build_material("mug", maps)
    assert len(empty_file.data.images) == 4
    assert all(image.packed_file is not None for image in empty_file.data.images)


def test_a_constant_map_becomes_a_value(maps, empty_file):
    still = MaterialMaps(maps.albedo, maps.baked, 0.25, maps.metallic)
    material = build_material("mug", still)
    assert source(material, "Roughness") is None
    assert material.node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value == pytest.approx(0.25)
    assert source(material, "Metallic") is not None
    assert "mug roughness" not in empty_file.data.images


def test_a_map_that_varies_by_two_steps_stays_a_texture(maps):
    roughness = torch.full((1, 16, 16), 0.5)
    roughness[0, 3, 3] += 2 / 255
    material = build_material("mug", MaterialMaps(maps.albedo, maps.baked, roughness, maps.metallic))
    assert source(material, "Roughness") is not None


def test_two_channels_are_refused():
    with pytest.raises(ValueError, match=r"\(2, 4, 4\)"):
        image_from_map("wrong", torch.zeros(2, 4, 4), "Non-Color")
