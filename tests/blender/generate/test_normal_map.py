"""The tangent space of our normal maps is the one in which Blender decodes them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from arm_blender.graphics.meshes import angle_weighted_normals
from arm_blender.graphics.tangents import corner_tangents
from arm_blender.structures import RelightableAsset, UvMesh

bpy = pytest.importorskip("bpy")
from arm_blender.blender.asset.material_nodes import build_material  # noqa: E402
from arm_blender.blender.asset.scene import build_mesh, build_object, replace_maps  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]


@pytest.mark.parametrize("mirrored", [False, True])
def test_tangents_and_normals_equal_blenders(make_mesh, mirrored):
    mesh = make_mesh(17, 9)
    generator = torch.Generator().manual_seed(4)
    vertices = mesh.vertices + 0.03 * torch.randn(mesh.vertices.shape, generator=generator)
    uvs = mesh.uvs * torch.tensor([-1.0, 1.0]) + torch.tensor([1.0, 0.0]) if mirrored else mesh.uvs
    mesh = UvMesh(vertices, mesh.faces, uvs, mesh.face_uvs, 1)
    normals = angle_weighted_normals(mesh.vertices, mesh.faces)
    tangents, sign = corner_tangents(mesh, normals)
    built = build_mesh("ring", mesh)
    built.calc_tangents(uvmap="UVMap")
    np.testing.assert_allclose(np.array([v.normal for v in built.vertices]), normals.numpy(), atol=2e-3)
    theirs = np.array([loop.tangent for loop in built.loops]).reshape(-1, 3, 3)
    assert (theirs * tangents.numpy()).sum(axis=2).min() > 0.99999
    assert np.array_equal(np.array([loop.bitangent_sign for loop in built.loops]).reshape(-1, 3)[:, 0], sign.numpy())


def test_a_normal_map_reaches_the_surface_as_data_in_tangent_space(asset):
    flat = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 16, 16).contiguous()
    maps = type(asset.maps)(asset.maps.albedo, asset.maps.baked, asset.maps.roughness, asset.maps.metallic, flat)
    material = build_material("ring", RelightableAsset("ring", asset.mesh, maps).maps)
    surface = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    decoder = surface.inputs["Normal"].links[0].from_node
    assert (decoder.type, decoder.space, decoder.uv_map) == ("NORMAL_MAP", "TANGENT", "UVMap")
    image = decoder.inputs["Color"].links[0].from_node.image
    assert image.colorspace_settings.name == "Non-Color"
    np.testing.assert_allclose(image.pixels[:3], [0.5, 0.5, 1.0], atol=0.51 / 255)


def test_a_normal_map_stays_where_the_other_maps_are_replaced(asset):
    flat = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 16, 16).contiguous()
    shown = build_object(replace(asset, maps=replace(asset.maps, normal=flat)), {})
    image, albedo = (shown.active_material.node_tree.nodes[name].image for name in ("Normal", "Albedo"))
    name, old = image.name, albedo.name
    replace_maps(shown, asset.maps, {})
    nodes = shown.active_material.node_tree.nodes
    assert nodes["Normal"].image == image and image.name == name
    assert nodes["Albedo"].image.name == old and not [i for i in bpy.data.images if i.name.startswith("old ")]
    assert any(node.type == "NORMAL_MAP" and node.outputs["Normal"].links for node in nodes)
