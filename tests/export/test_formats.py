"""Every format read back by another program is the asset: geometry, UVs, maps, colour spaces, normal map."""

import zipfile

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from torch.nn import functional

from arm_blender.errors import ArmError
from arm_blender.export import FORMATS, formats_of, write_asset, written_names
from arm_blender.export.usd import ALIGNMENT
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.graphics.light.spherical_harmonics import WHITE
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh

T = 16
NAME = "my cup"


@pytest.fixture
def asset() -> RelightableAsset:
    """An ellipsoid of two charts with noise for maps; metallic is one value."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = torch.from_numpy(sphere.vertices.copy()).float(), torch.from_numpy(sphere.faces.copy()).long()
    upper = vertices[faces].mean(dim=1)[:, 2] > 0.0
    flat = 0.2 + 0.2 * vertices[:, :2]
    uvs, face_uvs = torch.cat([flat, flat + 0.5]), faces + upper[:, None] * len(vertices)
    mesh = UvMesh(vertices * torch.tensor([1.0, 0.5, 0.8]), faces, uvs, face_uvs, 2)
    generator = torch.Generator().manual_seed(0)
    albedo, baked, roughness = (torch.rand(channels, T, T, generator=generator) for channels in (3, 3, 1))
    normal = functional.normalize(
        torch.rand(3, T, T, generator=generator) + torch.tensor([-0.5, -0.5, 1])[:, None, None], dim=0
    )
    light = torch.cat([torch.full((1, 3), WHITE), 0.3 * torch.randn(8, 3, generator=generator)])
    return RelightableAsset(NAME, mesh, MaterialMaps(albedo, baked, roughness, 0.2, normal, light=light))


@pytest.fixture
def out(asset, tmp_path):
    write_asset(asset, Report("small", "cpu", 0), tmp_path / "out", formats=tuple(FORMATS))
    return tmp_path / "out"


def test_all_that_is_written_was_announced(asset, out):
    found = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    announced = set(written_names(NAME, tuple(FORMATS)))
    of_regions = {name for name in announced if "regions" in name or "predicted" in name}  # It has none.
    assert found | {f"{NAME}.blend", "preview.png", "comparison.png"} == announced - of_regions


def test_names_of_formats_are_checked():
    assert formats_of("obj, glb,obj") == ("obj", "glb")
    with pytest.raises(ArmError, match="--export fbx.*glb.*usd"):
        formats_of("glb,fbx")


def world_from_y_up(vectors: np.ndarray) -> np.ndarray:
    return np.stack([vectors[:, 0], -vectors[:, 2], vectors[:, 1]], axis=1)


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_trimesh_reads_the_mesh_back(asset, out, kind):
    found = trimesh.load(out / f"{NAME}.{kind}", process=False, force="mesh")
    corners = asset.mesh.vertices[asset.mesh.faces].numpy()
    np.testing.assert_allclose(world_from_y_up(found.vertices)[found.faces], corners, atol=1e-7)
    uvs = asset.mesh.uvs[asset.mesh.face_uvs].numpy()
    np.testing.assert_allclose(found.visual.uv[found.faces], uvs, atol=1e-7)
    # Of the ellipsoid's surface the normals are known.
    exact = asset.mesh.vertices.numpy() / np.array([1.0, 0.5, 0.8]) ** 2
    exact = exact[asset.mesh.faces] / np.linalg.norm(exact[asset.mesh.faces], axis=2, keepdims=True)
    normals = world_from_y_up(found.vertex_normals)[found.faces]
    assert (normals * exact).sum(axis=2).min() > 0.98


def read(path) -> np.ndarray:
    return np.asarray(Image.open(path), dtype=np.float32) / 255.0


def test_an_obj_names_its_maps(asset, out):
    material = dict(line.split(" ", 1) for line in (out / f"{NAME}.mtl").read_text().splitlines())
    assert float(material["Pm"]) == pytest.approx(0.2) and "map_Pm" not in material
    np.testing.assert_allclose(read(out / material["map_Pr"]), asset.maps.roughness[0].numpy(), atol=0.51 / 255)
    albedo = srgb_from_linear(asset.maps.albedo).permute(1, 2, 0).numpy()
    np.testing.assert_allclose(read(out / material["map_Kd"]), albedo, atol=0.51 / 255)
    normal = asset.maps.normal.permute(1, 2, 0).numpy()
    np.testing.assert_allclose(2.0 * read(out / material["norm"]) - 1.0, normal, atol=1.02 / 255)


def test_a_glb_holds_the_normal_map(asset, out):
    material = trimesh.load(out / f"{NAME}.glb").geometry[NAME].visual.material
    packed = np.asarray(material.normalTexture.convert("RGB"), dtype=np.float32) / 255.0
    np.testing.assert_allclose(2.0 * packed - 1.0, asset.maps.normal.permute(1, 2, 0).numpy(), atol=1.02 / 255)


def test_a_usdz_is_stored_and_aligned_and_holds_what_it_names(out):
    path = out / f"{NAME}.usdz"
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        entries = archive.infolist()
        assert entries[0].filename.endswith(".usda")  # The first file is the one that is shown.
        text = archive.read(entries[0]).decode()
        assert {entry.filename for entry in entries[1:]} == {
            f"textures/{n}.png" for n in ("albedo", "roughness", "normal")
        }
        assert all(f"@./{entry.filename}@" in text for entry in entries[1:])
    data = path.read_bytes()
    for entry in entries:
        name, extra = (int.from_bytes(data[entry.header_offset + at :][:2], "little") for at in (26, 28))
        assert entry.compress_type == zipfile.ZIP_STORED
        assert (entry.header_offset + 30 + name + extra) % ALIGNMENT == 0


@pytest.mark.blender
@pytest.mark.parametrize("suffix", ["usda", "usdz", "glb", "obj"])
def test_blender_reads_the_asset_back(asset, out, suffix):
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    path = str(out / f"{NAME}.{suffix}")
    if suffix.startswith("usd"):
        bpy.ops.wm.usd_import(filepath=path)
    elif suffix == "obj":
        bpy.ops.wm.obj_import(filepath=path)
    else:
        bpy.ops.import_scene.gltf(filepath=path)
    found = next(item for item in bpy.data.objects if item.type == "MESH")
    turn = np.array(found.matrix_world.to_3x3())
    corners = np.array([found.data.vertices[loop.vertex_index].co for loop in found.data.loops]) @ turn.T
    np.testing.assert_allclose(corners, asset.mesh.vertices[asset.mesh.faces].reshape(-1, 3).numpy(), atol=1e-6)
    uvs = np.array([corner.uv for corner in found.data.uv_layers.active.data])
    np.testing.assert_allclose(uvs, asset.mesh.uvs[asset.mesh.face_uvs].reshape(-1, 2).numpy(), atol=1e-6)
    surface = next(node for node in found.active_material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    expected = {"Base Color": "albedo", "Roughness": "roughness", "Normal": "normal"}
    for socket, name in expected.items():
        image = image_behind(surface, socket)
        pixels = np.array(image.pixels[:]).reshape(T, T, 4)[::-1]
        if suffix == "glb" and name == "roughness":  # glTF: green is roughness, blue is metallic.
            stored, wanted = pixels[..., 1:3], np.stack([asset.maps.roughness[0].numpy(), np.full((T, T), 0.2)], -1)
        else:
            stored, wanted = pixels[..., :3], read(out / "textures" / f"{name}.png").reshape(T, T, -1)
        np.testing.assert_allclose(stored, np.broadcast_to(wanted, stored.shape), atol=1.02 / 255)
        if suffix != "obj":  # The format knows no colour spaces.
            assert image.colorspace_settings.name == ("sRGB" if name == "albedo" else "Non-Color")
    if suffix != "glb":
        assert surface.inputs["Metallic"].default_value == pytest.approx(0.2)


def image_behind(surface, socket: str):
    """The image that reaches an input of the Principled BSDF, through whatever nodes."""
    node = surface.inputs[socket].links[0].from_node
    while node.type != "TEX_IMAGE":
        node = next(i for i in node.inputs if i.is_linked).links[0].from_node
    return node.image
