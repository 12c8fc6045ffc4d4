"""What is read back from the files is what was written; an asset's folder is whole or not marked so."""

import io
import json

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from arm_blender.errors import Cancelled, OutputError
from arm_blender.export import is_whole, write_asset
from arm_blender.export.gltf import gltf_vertices, write_glb
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh

T = 32


@pytest.fixture
def mesh() -> UvMesh:
    """A sphere cut by a seam: its upper and its lower half have UVs of their own."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = torch.from_numpy(sphere.vertices.copy()).float(), torch.from_numpy(sphere.faces.copy()).long()
    upper = vertices[faces].mean(dim=1)[:, 2] > 0.0
    flat = 0.2 + 0.2 * vertices[:, :2]
    uvs = torch.cat([flat, flat + 0.5])
    return UvMesh(vertices * torch.tensor([1.0, 0.5, 0.8]), faces, uvs, faces + upper[:, None] * len(vertices), 2)


@pytest.fixture
def asset(mesh) -> RelightableAsset:
    generator = torch.Generator().manual_seed(0)
    maps = [torch.rand(channels, T, T, generator=generator) for channels in (3, 3, 1)]
    return RelightableAsset("cup", mesh, MaterialMaps(*maps, metallic=0.2))


def written(asset, tmp_path, **options):
    return write_asset(asset, Report("small", "cpu", 0), tmp_path / "out", **options)


def read_glb(path) -> trimesh.Trimesh:
    return trimesh.load(path, process=False).geometry["cup"]


def test_the_glb_holds_the_mesh(asset, tmp_path):
    """Z up becomes Y up; corners of a vertex that share a UV share a glTF vertex; positions are the welded ones."""
    write_glb(asset, tmp_path / "cup.glb")
    found = read_glb(tmp_path / "cup.glb")
    world = np.stack([found.vertices[:, 0], -found.vertices[:, 2], found.vertices[:, 1]], axis=1)
    corners = asset.mesh.vertices[asset.mesh.faces].numpy()
    np.testing.assert_allclose(world[found.faces], corners, atol=1e-6)
    np.testing.assert_allclose(found.visual.uv[found.faces], asset.mesh.uvs[asset.mesh.face_uvs].numpy(), atol=1e-6)
    pairs = {(int(v), int(u)) for v, u in zip(asset.mesh.faces.flatten(), asset.mesh.face_uvs.flatten(), strict=True)}
    assert len(found.vertices) == len(pairs)
    assert found.volume > 0.0


def test_normals_are_smooth_across_the_seam(mesh):
    vertices = gltf_vertices(mesh)
    groups: dict[tuple, list] = {}
    for position, normal in zip(vertices.position, vertices.normal, strict=True):
        groups.setdefault(tuple(position), []).append(normal)
    split = [normals for normals in groups.values() if len(normals) > 1]
    assert split and all(np.array_equal(normals[0], other) for normals in split for other in normals)
    # The ellipsoid's gradient is the closed form; its faces are a coarse stand-in.
    exact = vertices.position / np.array([1.0, 0.8, 0.5]) ** 2  # x, z, -y
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    assert (vertices.normal * exact).sum(axis=1).min() > 0.98


def test_the_glb_holds_the_maps(asset, tmp_path):
    write_glb(asset, tmp_path / "cup.glb")
    material = read_glb(tmp_path / "cup.glb").visual.material
    albedo = np.asarray(material.baseColorTexture.convert("RGB"), dtype=np.float32) / 255.0
    np.testing.assert_allclose(albedo, srgb_from_linear(asset.maps.albedo).permute(1, 2, 0).numpy(), atol=0.51 / 255)
    packed = np.asarray(material.metallicRoughnessTexture.convert("RGB"), dtype=np.float32) / 255.0
    np.testing.assert_allclose(packed[..., 1], asset.maps.roughness[0].numpy(), atol=0.51 / 255)
    np.testing.assert_allclose(packed[..., 2], 0.2, atol=0.51 / 255)
    assert material.roughnessFactor in (None, 1.0) and material.metallicFactor in (None, 1.0)


def test_two_constant_maps_become_values(asset, mesh, tmp_path):
    maps = MaterialMaps(asset.maps.albedo, asset.maps.baked, 0.6, 0.0)
    write_glb(RelightableAsset("cup", mesh, maps), tmp_path / "cup.glb")
    material = read_glb(tmp_path / "cup.glb").visual.material
    assert material.metallicRoughnessTexture is None
    assert material.roughnessFactor == pytest.approx(0.6) and material.metallicFactor == 0.0


@pytest.mark.blender
def test_blender_imports_what_was_exported(asset, tmp_path):
    import bpy

    write_glb(asset, tmp_path / "cup.glb")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "cup.glb"))
    found = bpy.data.objects["cup"].data
    corner_vertices = np.array([loop.vertex_index for loop in found.loops])
    positions = np.array([vertex.co for vertex in found.vertices])[corner_vertices]
    np.testing.assert_allclose(positions, asset.mesh.vertices[asset.mesh.faces].reshape(-1, 3).numpy(), atol=1e-6)
    uvs = np.array([corner.uv for corner in found.uv_layers.active.data])
    np.testing.assert_allclose(uvs, asset.mesh.uvs[asset.mesh.face_uvs].reshape(-1, 2).numpy(), atol=1e-6)


def test_all_files_are_there_and_the_report_comes_last(asset, tmp_path):
    files = written(asset, tmp_path, further=lambda stage: (stage / "cup.blend").write_bytes(b"x"))
    names = [str(path.relative_to(tmp_path / "out")) for path in files]
    textures = [f"textures/{name}.png" for name in ("albedo", "baked", "metallic", "roughness")]
    assert sorted(names) == sorted(["cup.blend", "cup.glb", *textures, "report.json"])
    assert names[-1] == "report.json" and all(path.is_file() for path in files)
    assert is_whole(tmp_path / "out")
    assert "files" in json.loads((tmp_path / "out" / "report.json").read_text())["seconds"]
    tops = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert tops == ["cup.blend", "cup.glb", "report.json", "textures"]


def test_textures_hold_the_maps_and_constants_are_small(asset, tmp_path):
    written(asset, tmp_path)

    def read(name):
        data = (tmp_path / "out" / "textures" / f"{name}.png").read_bytes()
        return np.asarray(Image.open(io.BytesIO(data)), dtype=np.float32) / 255.0

    for name in ("albedo", "baked"):
        expected = srgb_from_linear(getattr(asset.maps, name)).permute(1, 2, 0).numpy()
        np.testing.assert_allclose(read(name), expected, atol=0.51 / 255)
    np.testing.assert_allclose(read("roughness"), asset.maps.roughness[0].numpy(), atol=0.51 / 255)
    assert read("metallic").shape == (4, 4)
    np.testing.assert_allclose(read("metallic"), 0.2, atol=0.51 / 255)


@pytest.mark.parametrize("stop_at", ["writing textures", "writing cup.glb", "writing report.json"])
def test_stopping_leaves_nothing_new(asset, tmp_path, stop_at):
    def stop(fraction, message):
        if message == stop_at:
            raise Cancelled("stopped")

    with pytest.raises(Cancelled):
        written(asset, tmp_path, progress=stop)
    assert not (tmp_path / "out").exists()
    files = written(asset, tmp_path)
    before = {path: path.read_bytes() for path in files}
    with pytest.raises(Cancelled):
        written(asset, tmp_path, progress=stop)
    assert {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()} == before


def test_an_older_asset_is_replaced_and_other_files_stay(asset, tmp_path):
    written(asset, tmp_path)
    (tmp_path / "out" / "notes.txt").write_text("mine")
    darker = MaterialMaps(asset.maps.albedo * 0.5, asset.maps.baked, asset.maps.roughness, asset.maps.metallic)
    written(RelightableAsset("cup", asset.mesh, darker), tmp_path)
    albedo = np.asarray(Image.open(tmp_path / "out" / "textures" / "albedo.png"), dtype=np.float32) / 255.0
    np.testing.assert_allclose(albedo, srgb_from_linear(darker.albedo).permute(1, 2, 0).numpy(), atol=0.51 / 255)
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("obstacle", ["textures", "cup.glb", "report.json"])
def test_what_is_in_the_way_is_named_and_nothing_is_moved(asset, tmp_path, obstacle):
    out = tmp_path / "out"
    out.mkdir()
    if obstacle == "textures":
        (out / obstacle).write_text("mine")
    else:
        (out / obstacle).mkdir()
    with pytest.raises(OutputError, match=f"{obstacle}: is a"):
        written(asset, tmp_path)
    assert [path.name for path in out.rglob("*")] == [obstacle]


def test_a_full_disk_is_an_error_with_a_remedy(asset, tmp_path):
    def full(stage):
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left on device"):
        written(asset, tmp_path, further=full)
    assert not (tmp_path / "out").exists()
