"""Relit pictures show the asset whole, in the colours that theory gives, and leave the open file as it was."""

import numpy as np
import pytest

from arm_blender.errors import ArmError, InputImageError
from arm_blender.structures import MaterialMaps, RelightableAsset

bpy = pytest.importorskip("bpy")
from bpy_extras.object_utils import world_to_camera_view  # noqa: E402

from arm_blender.blender.export import save_blend  # noqa: E402
from arm_blender.blender.relight import RelightConfig, preview, relight  # noqa: E402
from arm_blender.blender.scene import build_object  # noqa: E402
from arm_blender.blender.studio import add_camera, bounding_sphere, environment_path, temporary_scene  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]

TINY = RelightConfig(resolution=24, samples=2)


def pixels(path) -> np.ndarray:
    """(H, W, 4) as stored, top row first."""
    image = bpy.data.images.load(str(path), check_existing=False)
    width, height = image.size
    result = np.array(image.pixels[:]).reshape(height, width, 4)[::-1]
    bpy.data.images.remove(image)
    return result


@pytest.fixture
def white_sky(tmp_path):
    image = bpy.data.images.new("white", 8, 4, float_buffer=True)
    image.pixels.foreach_set(np.ones(8 * 4 * 4, dtype=np.float32))
    image.filepath_raw, image.file_format = str(tmp_path / "white.hdr"), "HDR"
    image.save()
    bpy.data.images.remove(image)
    return tmp_path / "white.hdr"


def test_metal_under_a_white_sky_shows_its_base_color(make_mesh, make_plain_maps, white_sky, tmp_path):
    color = np.array([0.6, 0.3, 0.15])
    asset = RelightableAsset("mirror", make_mesh(96, 48), make_plain_maps(tuple(color), roughness=0.0, metallic=1.0))
    config = RelightConfig(resolution=32, samples=16, elevation_deg=90.0)
    shown = pixels(relight(build_object(asset, {}), [white_sky], tmp_path, config)[0])
    # From above, the crest of the torus faces the camera: it mirrors the sky times its colour. Khronos' neutral view
    # takes 0.04 off, which is what a dielectric's reflection adds.
    expected = 1.055 * (color - 0.04) ** (1 / 2.4) - 0.055
    brightest = shown[16, 3:29][shown[16, 3:29, 3] == 1.0, :3]
    error = np.abs(brightest - expected).max(axis=1).min()
    assert error < 3 / 255


@pytest.mark.parametrize("azimuth_deg, elevation_deg", [(0, 0), (130, 40), (250, -89)])
def test_the_camera_has_every_vertex_in_its_picture(asset, azimuth_deg, elevation_deg):
    shown = build_object(asset, {})
    shown.location, shown.scale = (5.0, -3.0, 2.0), (0.01, 0.02, 0.01)
    bpy.context.view_layer.update()
    camera = add_camera(bpy.context.scene, *bounding_sphere([shown]), azimuth_deg, elevation_deg)
    bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = 64
    bpy.context.view_layer.update()
    seen = np.array(
        [world_to_camera_view(bpy.context.scene, camera, shown.matrix_world @ v.co) for v in shown.data.vertices]
    )
    assert (seen[:, :2] > 0).all() and (seen[:, :2] < 1).all()
    assert (seen[:, 2] > camera.data.clip_start).all() and (seen[:, 2] < camera.data.clip_end).all()


def test_azimuth_zero_looks_from_the_front():
    with temporary_scene("front") as scene:
        camera = add_camera(scene, bpy.context.scene.cursor.location, 1.0, 0.0, 0.0)
        assert camera.location.y < -1.0
        assert abs(camera.location.x) < 1e-5 and abs(camera.location.z) < 1e-5


def test_every_environment_and_turn_gives_a_picture(asset, tmp_path):
    config = RelightConfig(resolution=16, samples=1, turntable=2)
    pictures = relight(build_object(asset, {}), ["forest", "night"], tmp_path / "new", config)
    assert [path.name for path in pictures] == [
        f"ring_{name}_{turn:03d}.png" for name in ("forest", "night") for turn in (0, 1)
    ]
    assert sorted((tmp_path / "new").iterdir()) == sorted(pictures)
    day, night = pixels(pictures[0]), pixels(pictures[2])
    assert day[..., :3].mean() > night[..., :3].mean()


def test_half_a_turn_shows_the_other_side(make_mesh, maps, tmp_path):
    two_sided = maps.albedo.new_zeros(3, 16, 16)
    two_sided[0, :, :8], two_sided[2, :, 8:] = 1.0, 1.0  # One half of the ring is red, the other blue.
    sides = MaterialMaps(two_sided, maps.baked, maps.roughness * 0 + 1, maps.metallic * 0)
    ring = build_object(RelightableAsset("sides", make_mesh(24, 12), sides), {})
    config = RelightConfig(resolution=24, samples=4, turntable=2, azimuth_deg=0.0, elevation_deg=0.0)
    front, back = (pixels(path) for path in relight(ring, ["studio"], tmp_path, config))
    assert (front[..., 2] * front[..., 3]).sum() > 2 * (front[..., 0] * front[..., 3]).sum()
    assert (back[..., 0] * back[..., 3]).sum() > 2 * (back[..., 2] * back[..., 3]).sum()


@pytest.mark.parametrize("suffix", [".blend", ".glb"])
def test_files_are_relit_like_the_object_and_leave_no_trace(asset, tmp_path, suffix):
    file = tmp_path / f"ring{suffix}"
    shown = build_object(asset, {})
    if suffix == ".blend":
        save_blend(asset, file, {})
    else:
        bpy.ops.export_scene.gltf(filepath=str(file), use_selection=True)
    before = sorted(item.name for item in bpy.data.user_map())
    from_object = pixels(relight(shown, ["forest"], tmp_path / "object", TINY)[0])
    from_file = pixels(relight(file, ["forest"], tmp_path / "file", TINY)[0])
    assert np.abs(from_object - from_file).mean() < 0.02
    after = sorted(item.name for item in bpy.data.user_map() if item.name != "Render Result")
    assert after == before
    assert bpy.context.object == shown and list(bpy.context.selected_objects) == [shown]
    assert np.array_equal(np.array(shown.matrix_world), np.eye(4)) and shown.parent is None


def test_the_preview_is_a_sheet_on_an_even_backdrop(asset, tmp_path):
    save_blend(asset, tmp_path / "ring.blend", {})
    preview(tmp_path / "ring.blend", tmp_path / "preview.png", resolution=20, samples=2)
    sheet = pixels(tmp_path / "preview.png")
    assert sheet.shape == (40, 40, 4)
    assert (sheet[..., 3] == 1.0).all()
    backdrop = sheet[0, 0]
    tiles = [sheet[r : r + 20, c : c + 20, :3] for r in (0, 20) for c in (0, 20)]
    for tile in tiles:
        assert np.array_equal(tile[0, 0], backdrop[:3])
        assert (np.abs(tile - backdrop[:3]).max(axis=-1) > 0.05).mean() > 0.1, "the object covers part of each tile"
    assert np.abs(tiles[0] - tiles[1]).mean() > 0.01, "two environments differ"


def test_nothing_but_the_callers_own_words_reaches_the_standard_output(asset, tmp_path, capfd):
    print("before")
    save_blend(asset, tmp_path / "ring.blend", {})
    relight(tmp_path / "ring.blend", ["forest"], tmp_path / "out", TINY)
    with pytest.raises(ArmError):
        relight(tmp_path / "missing.glb", ["forest"], tmp_path / "out", TINY)
    print("after")
    assert capfd.readouterr().out == "before\nafter\n"


def test_an_unknown_environment_names_those_that_there_are():
    with pytest.raises(InputImageError, match="moonbase.*forest.*sunset"):
        environment_path("moonbase")


@pytest.mark.parametrize("content", [b"", b"no picture", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n\1"])
def test_an_environment_that_is_no_picture_is_named(asset, tmp_path, content):
    (tmp_path / "sky.hdr").write_bytes(content)
    with pytest.raises(InputImageError, match="sky.hdr"):
        relight(build_object(asset, {}), [tmp_path / "sky.hdr"], tmp_path / "out", TINY)
    assert not (tmp_path / "out").exists()


def test_what_is_no_asset_is_an_error_of_one_line(tmp_path):
    (tmp_path / "broken.glb").write_bytes(b"glTF nonsense")
    (tmp_path / "broken.blend").write_bytes(b"nonsense")
    (tmp_path / "mug.txt").write_text("a mug")
    for name in ("broken.glb", "broken.blend", "mug.txt", "missing.blend"):
        with pytest.raises(ArmError, match=name) as caught:
            relight(tmp_path / name, ["forest"], tmp_path / "out", TINY)
        assert "\n" not in str(caught.value)
    assert [scene.name for scene in bpy.data.scenes] == ["Scene"]
