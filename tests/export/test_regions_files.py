"""Regions on disk: what was predicted comes back, and every format shows what was set."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from arm_blender.errors import ArmError
from arm_blender.export import FORMATS, rewrite_asset, write_asset, written_names
from arm_blender.export.asset_folder import read_asset
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.graphics.light.spherical_harmonics import COUNT, WHITE
from arm_blender.knobs.finishes import PRESETS, finishes_of
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, Regions, RelightableAsset, UvMesh
from arm_blender.uv.finish import chosen_finishes
from arm_blender.views.image_io import write_png

T = 16


@pytest.fixture
def asset() -> RelightableAsset:
    """A box whose left half of the atlas is region 1; metallic is one value that 8 bits do not have."""
    box = trimesh.creation.box()
    vertices, faces = torch.from_numpy(box.vertices.copy()).float(), torch.from_numpy(box.faces.copy()).long()
    corner = torch.tensor([[0.1, 0.1], [0.9, 0.1], [0.9, 0.9]])
    cells = torch.stack(torch.meshgrid(torch.arange(4), torch.arange(3), indexing="ij"), -1).reshape(12, 1, 2)
    uvs = ((cells + corner) / torch.tensor([4.0, 3.0])).reshape(-1, 2)
    mesh = UvMesh(vertices, faces, uvs, torch.arange(36).view(12, 3), 12)
    generator = torch.Generator().manual_seed(0)
    albedo, baked, roughness = (torch.rand(channels, T, T, generator=generator) for channels in (3, 3, 1))
    index = torch.ones(T, T, dtype=torch.uint8)
    index[:, T // 2 :] = 2
    regions = Regions(index, (0.5, 0.5), ((0.2, 0.4, 0.6), (0.5, 0.5, 0.5)), (1.3, 1.1, 0.9))
    return RelightableAsset("cup", mesh, MaterialMaps(albedo, baked, roughness, 0.123456789, None, regions))


def written(asset: RelightableAsset, folder, words: str | None):
    """The folder of an asset with finishes."""
    report = Report("small", "cpu", 0, name=asset.name, charts=asset.mesh.charts)
    given = RelightableAsset(asset.name, asset.mesh, chosen_finishes(asset.maps, words, report))
    write_asset(given, report, folder, formats=tuple(FORMATS))
    return folder


def set_again(folder, words: str | None):
    """As the command does."""
    found = read_asset(folder)
    maps = found.asset.maps
    regions = Regions(maps.regions.index, maps.regions.area, maps.regions.swatch, maps.regions.light)
    report = Report("small", "cpu", 0)
    plain = MaterialMaps(maps.albedo, maps.baked, maps.roughness, maps.metallic, maps.normal, regions)
    maps = chosen_finishes(plain, words, report)
    again = RelightableAsset(found.asset.name, found.asset.mesh, maps)
    rewrite_asset(again, found.report | {"regions": report.regions}, folder, found.formats)


def with_light(folder, harmonics) -> None:
    report = json.loads((folder / "report.json").read_text())
    (folder / "report.json").write_text(json.dumps(report | {"light": {"harmonics": harmonics}}))


def pixels(path) -> np.ndarray:
    return np.asarray(Image.open(path)).astype(int)


def contents(folder) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "report.json"
    }


def test_all_that_is_written_was_announced(asset, tmp_path):
    folder = written(asset, tmp_path / "out", "1=gold")
    found = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert found <= set(written_names("cup", tuple(FORMATS)))


def test_textures_show_what_is_set_and_the_predicted_ones_lie_beside(asset, tmp_path):
    textures = written(asset, tmp_path / "out", "1=gold") / "textures"
    plain = written(asset, tmp_path / "plain", None) / "textures"
    gold = (srgb_from_linear(torch.tensor(PRESETS["gold"].f0)) * 255).round().int().numpy()
    assert (pixels(textures / "albedo.png")[:, : T // 2] == gold).all()
    assert (pixels(textures / "albedo.png")[:, T // 2 :] == pixels(plain / "albedo.png")[:, T // 2 :]).all()
    assert (pixels(textures / "metallic.png")[:, : T // 2] == 255).all()
    assert (pixels(textures / "roughness.png")[:, : T // 2] == round(255 * PRESETS["gold"].roughness)).all()
    for name in ("albedo", "roughness", "metallic"):
        assert (textures / "predicted" / f"{name}.png").read_bytes() == (plain / f"{name}.png").read_bytes()
    assert not (plain / "predicted").exists()


def test_every_format_shows_what_is_set(asset, tmp_path):
    folder = written(asset, tmp_path / "out", "1=gold,2=rubber")
    material = trimesh.load(folder / "cup.glb", process=False).geometry["cup"].visual.material
    color = np.asarray(material.baseColorTexture.convert("RGB")).astype(int)
    assert (color == pixels(folder / "textures" / "albedo.png")).all()
    glossy = np.asarray(material.metallicRoughnessTexture.convert("RGB")).astype(int)
    assert (glossy[:, : T // 2, 2] == 255).all() and (glossy[:, T // 2 :, 2] == 0).all()
    assert (glossy[:, T // 2 :, 1] == round(255 * PRESETS["rubber"].roughness)).all()
    assert "inputs:metallic.connect" in (folder / "cup.usda").read_text()
    assert "map_Pm textures/metallic.png" in (folder / "cup.mtl").read_text()
    assert "inputs:metallic = 0.123457" in (written(asset, tmp_path / "plain", None) / "cup.usda").read_text()


def test_region_numbers_are_kept_as_they_are(asset, tmp_path):
    folder = written(asset, tmp_path / "out", None)
    with Image.open(folder / "textures" / "regions.png") as picture:
        assert picture.mode == "P" and (np.asarray(picture) == asset.maps.regions.index.numpy()).all()
        assert len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)) == 2
    assert Image.open(folder / "regions.png").size[0] > 1000


def test_a_folder_gives_its_asset_back(asset, tmp_path):
    found = read_asset(written(asset, tmp_path / "out", "2=0.25/0.5"))
    assert found.formats == tuple(FORMATS) and found.asset.name == "cup" and found.asset.mesh.charts == 12
    assert found.asset.maps.metallic == 0.123456789
    assert torch.equal(found.asset.maps.regions.index, asset.maps.regions.index)
    assert found.asset.maps.regions.finishes == finishes_of("2=0.25/0.5")
    assert found.asset.maps.regions.light == asset.maps.regions.light
    assert float((found.asset.maps.roughness - asset.maps.roughness).abs().max()) < 0.51 / 255
    corners, before = (a.mesh.vertices[a.mesh.faces].reshape(-1, 9) for a in (found.asset, asset))
    assert torch.equal(corners, before)


def test_the_light_goes_along_and_an_asset_without_takes_it_away(asset, tmp_path):
    folder = tmp_path / "out"
    light = torch.zeros(COUNT, 3)
    light[0], light[2] = WHITE, 1.0
    lit = replace(asset, maps=replace(asset.maps, light=light))
    report = Report("small", "cpu", 0, name=asset.name, charts=asset.mesh.charts)
    report.light = {"harmonics": light.tolist(), "psnr": 20.0, "views": []}
    lit = replace(lit, maps=chosen_finishes(lit.maps, None, report))
    write_asset(lit, report, folder, further=lambda stage: (stage / "comparison.png").write_bytes(b"sheet"))
    found = read_asset(folder)
    assert torch.equal(found.asset.maps.light, light)
    before = (folder / "light.exr").read_bytes()
    rewrite_asset(found.asset, found.report, folder, found.formats)
    assert (folder / "light.exr").read_bytes() == before
    # What was compared was the asset as it was.
    assert not (folder / "comparison.png").exists()
    report.light = None
    write_asset(asset, report, folder)
    assert not (folder / "light.exr").exists() and read_asset(folder).asset.maps.light is None


def test_what_is_not_of_an_asset_of_ours_stays(asset, tmp_path):
    own = tmp_path / "out" / "light.exr"
    own.parent.mkdir()
    own.write_bytes(b"mine")
    written(asset, own.parent, None)
    assert own.read_bytes() == b"mine"


def test_setting_and_taking_back_leaves_every_file_as_it_was(asset, tmp_path):
    folder = written(asset, tmp_path / "out", None)
    set_again(folder, None)  # The mesh's vertices have the order of the reader from here on.
    before, report = contents(folder), json.loads((folder / "report.json").read_text())
    set_again(folder, "1=chrome,2=0.3/1")
    changed = contents(folder)
    assert changed["cup.glb"] != before["cup.glb"] and "textures/predicted/albedo.png" in changed
    set_again(folder, "1=rubber")
    set_again(folder, None)
    assert contents(folder) == before and json.loads((folder / "report.json").read_text()) == report


def test_setting_later_is_as_setting_at_once(asset, tmp_path):
    at_once, later = (written(asset, tmp_path / name, words) for name, words in (("a", "1=gold"), ("b", None)))
    set_again(later, "1=gold")
    for name in ("albedo", "roughness", "metallic"):
        assert (pixels(at_once / "textures" / f"{name}.png") == pixels(later / "textures" / f"{name}.png")).all()


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda folder: (folder / "report.json").unlink(), "holds no whole asset"),
        (lambda folder: (folder / "report.json").write_text("{}"), "holds no whole asset"),
        (lambda folder: [(folder / f"cup.{kind}").unlink() for kind in ("glb", "obj")], "--export glb"),
        (lambda folder: with_light(folder, [[1.0, 1.0]]), "does not fit its textures"),
        (lambda folder: (folder / "textures" / "regions.png").unlink(), "no regions of ours"),
        (lambda folder: (folder / "textures" / "regions.png").write_bytes(b"no"), "no regions of ours"),
        (lambda folder: (folder / "textures" / "baked.png").unlink(), "baked.png"),
    ],
    ids=["no report", "another report", "no mesh", "another light", "no regions", "spoilt regions", "no texture"],
)
def test_what_is_missing_is_said_in_one_line(asset, tmp_path, spoil, line):
    folder = written(asset, tmp_path / "out", None)
    spoil(folder)
    with pytest.raises(ArmError, match=line):
        read_asset(folder)


def test_a_normal_map_comes_back_and_one_of_an_earlier_asset_does_not(asset, tmp_path):
    folder = written(asset, tmp_path / "out", "1=gold")
    normal = torch.nn.functional.normalize(torch.rand(3, T, T, generator=torch.Generator().manual_seed(2)), dim=0)
    write_png(folder / "textures" / "normal.png", 0.5 + 0.5 * normal, srgb=False)
    assert read_asset(folder).asset.maps.normal is None
    report = json.loads((folder / "report.json").read_text())
    (folder / "report.json").write_text(json.dumps(report | {"seconds": {"normal map": 1.0}}))
    assert float((read_asset(folder).asset.maps.normal - normal).abs().max()) < 1.01 / 255
    before = (folder / "textures" / "normal.png").read_bytes()
    set_again(folder, "1=gold")
    assert (folder / "textures" / "normal.png").read_bytes() == before


def test_an_asset_from_before_regions_is_refused(asset, tmp_path):
    maps = MaterialMaps(asset.maps.albedo, asset.maps.baked, 0.5, 0.0)
    folder = written(RelightableAsset("cup", asset.mesh, maps), tmp_path / "out", None)
    assert not (folder / "regions.png").exists()
    with pytest.raises(ArmError, match="before assets had regions; generate it again"):
        read_asset(folder)
