"""What regions are set to reaches every file that is written, and every picture that is rendered of one."""

import json
import math
import struct
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from arm_blender.knobs.finishes import PRESETS

bpy = pytest.importorskip("bpy")
from arm_blender.blender.asset.blend_file import save_blend  # noqa: E402
from arm_blender.blender.asset.finish_nodes import finishes, set_finish  # noqa: E402
from arm_blender.blender.asset.object_asset import asset_from_object  # noqa: E402
from arm_blender.blender.relight.renders import RelightConfig, relight  # noqa: E402

pytestmark = pytest.mark.blender

GOLD = PRESETS["gold"]
SIDE = 16


def texels(picture: Image.Image) -> np.ndarray:
    """(H, W, 3) in [0, 1] as stored."""
    return np.asarray(picture.convert("RGB"), dtype=np.float32) / 255.0


def in_glb(path: Path) -> dict[str, Image.Image]:
    """The pictures of base colour, and of roughness and metallic."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    surface = document["materials"][0]["pbrMetallicRoughness"]
    found = {}
    for name in ("baseColorTexture", "metallicRoughnessTexture"):
        image = document["images"][document["textures"][surface[name]["index"]]["source"]]
        view = document["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        found[name] = Image.open(BytesIO(binary[start : start + view["byteLength"]]))
    return found


def is_gold(albedo: np.ndarray, roughness: np.ndarray, metallic: np.ndarray, maps) -> None:
    """The lower right is gold, the left as predicted."""
    encoded = [12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055 for v in GOLD.f0]
    set_texels = slice(SIDE // 4, SIDE), slice(SIDE // 2, SIDE)
    assert np.abs(albedo[set_texels] - encoded).max() < 1 / 255
    assert np.abs(roughness[set_texels] - GOLD.roughness).max() < 1 / 255
    assert np.abs(metallic[set_texels] - 1.0).max() < 1 / 255
    left = np.s_[:, : SIDE // 2]
    assert np.abs(roughness[left] - maps.roughness[0].numpy()[left]).max() < 2 / 255
    assert np.abs(metallic[left] - maps.metallic[0].numpy()[left]).max() < 2 / 255


def test_every_format_of_the_export_has_what_is_set(shown, maps, tmp_path):
    set_finish(shown.active_material, 2, GOLD)
    assert bpy.ops.arm.export(directory=str(tmp_path), formats={"glb", "usd", "usdz", "obj"}) == {"FINISHED"}
    folder = tmp_path / "tile"
    maps_beside = [texels(Image.open(folder / "textures" / f"{n}.png")) for n in ("albedo", "roughness", "metallic")]
    is_gold(maps_beside[0], maps_beside[1][..., 0], maps_beside[2][..., 0], maps)  # Those of USD and OBJ.
    assert "textures/albedo.png" in (folder / "tile.mtl").read_text()
    assert "textures/albedo.png" in (folder / "tile.usda").read_text()
    glb = {name: texels(picture) for name, picture in in_glb(folder / "tile.glb").items()}
    packed = glb["metallicRoughnessTexture"]
    is_gold(glb["baseColorTexture"], packed[..., 1], packed[..., 2], maps)
    with zipfile.ZipFile(folder / "tile.usdz") as package:
        inside = {Path(name).name: package.read(name) for name in package.namelist()}
    in_usdz = [texels(Image.open(BytesIO(inside[f"{name}.png"]))) for name in ("albedo", "roughness", "metallic")]
    is_gold(in_usdz[0], in_usdz[1][..., 0], in_usdz[2][..., 0], maps)
    assert finishes(shown.active_material) == {2: GOLD}, "it stays set, and the prediction behind it"
    predicted = texels(Image.open(folder / "textures" / "predicted" / "roughness.png"))[..., 0]
    assert np.abs(predicted - maps.roughness[0].numpy()).max() < 2 / 255


def test_relighting_an_object_and_its_file_render_what_is_set(shown, tmp_path):
    shown.rotation_euler.x = math.pi / 2.0  # Upright, facing the camera.
    bpy.context.view_layer.update()
    config = RelightConfig(resolution=64, samples=16, azimuth_deg=0.0)

    def halves(source, name: str) -> NDArray[np.float32]:
        """(2, 3) mean displayed colours of the two regions."""
        (picture,) = relight(source, ["forest"], tmp_path / name, config)
        pixels = np.asarray(Image.open(picture), dtype=np.float32)
        assert pixels[24:40, 20:44, 3].min() == 255.0
        return np.stack([pixels[24:40, columns, :3].mean(axis=(0, 1)) for columns in (slice(20, 30), slice(34, 44))])

    before = halves(shown, "predicted")
    set_finish(shown.active_material, 2, GOLD)
    after = halves(shown, "set")
    save_blend(asset_from_object(shown), tmp_path / "tile.blend", {})
    filed = halves(tmp_path / "tile.blend", "filed")
    assert np.abs(after[0] - before[0]).max() < 8.0
    assert (after[1] - before[1])[0] - (after[1] - before[1])[2] > 25.0, "gold is yellow"
    assert np.abs(filed - after).max() < 8.0
