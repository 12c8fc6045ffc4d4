"""Relit pictures show the asset whole, in the colours that theory gives, and leave the open file as it was."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import arm_blender
from arm_blender.errors import ArmError, InputImageError
from arm_blender.structures import MaterialMaps, RelightableAsset

bpy = pytest.importorskip("bpy")
from bpy_extras.object_utils import world_to_camera_view  # noqa: E402

from arm_blender.blender.asset.blend_file import save_blend  # noqa: E402
from arm_blender.blender.asset.scene import build_object  # noqa: E402
from arm_blender.blender.asset.studio import add_camera, bounding_sphere, temporary_scene  # noqa: E402
from arm_blender.blender.compat import EEVEE, sequence_strips, use_eevee, use_png  # noqa: E402
from arm_blender.blender.relight import graphics_device  # noqa: E402
from arm_blender.blender.relight.environments import environment_path  # noqa: E402
from arm_blender.blender.relight.renders import RelightConfig, preview, relight  # noqa: E402
from arm_blender.blender.relight.video import write_video  # noqa: E402

pytestmark = [pytest.mark.blender, pytest.mark.usefixtures("empty_file")]

ROOT = Path(arm_blender.__file__).parents[1]
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
    sides = MaterialMaps(two_sided, maps.baked, 1.0, 0.0)
    ring = build_object(RelightableAsset("sides", make_mesh(24, 12), sides), {})
    config = RelightConfig(resolution=24, samples=4, turntable=2, azimuth_deg=0.0, elevation_deg=0.0)
    front, back = (pixels(path) for path in relight(ring, ["studio"], tmp_path, config))
    assert (front[..., 2] * front[..., 3]).sum() > 2 * (front[..., 0] * front[..., 3]).sum()
    assert (back[..., 0] * back[..., 3]).sum() > 2 * (back[..., 2] * back[..., 3]).sum()


def test_environments_of_one_name_have_pictures_of_their_own(asset, white_sky, tmp_path):
    (tmp_path / "dark").mkdir()
    image = bpy.data.images.new("dark", 8, 4, float_buffer=True)
    image.filepath_raw, image.file_format = str(tmp_path / "dark" / "white.hdr"), "HDR"
    image.save()
    bpy.data.images.remove(image)
    pictures = relight(build_object(asset, {}), [white_sky, tmp_path / "dark" / "white.hdr"], tmp_path / "out", TINY)
    assert [path.name for path in pictures] == ["ring_white_000.png", "ring_white-2_000.png"]
    assert pixels(pictures[0])[..., :3].sum() > 10 * pixels(pictures[1])[..., :3].sum()


@pytest.fixture
def half_sky(tmp_path):
    """Light from one side only: a bright quarter of the horizon, to one side of the middle."""
    image = bpy.data.images.new("half", 32, 16, float_buffer=True)
    values = np.zeros((16, 32, 4), dtype=np.float32)
    values[..., 3], values[6:10, 2:8, :3] = 1.0, 20.0
    image.pixels.foreach_set(values.ravel())
    image.filepath_raw, image.file_format = str(tmp_path / "half.hdr"), "HDR"
    image.save()
    bpy.data.images.remove(image)
    return tmp_path / "half.hdr"


def test_turning_everything_but_the_camera_is_turning_the_camera_back(make_mesh, make_plain_maps, half_sky, tmp_path):
    """Object and environment turned by one angle, seen from where the camera then is: the picture stays."""
    asset = RelightableAsset("plain", make_mesh(24, 12), make_plain_maps((0.8, 0.8, 0.8), roughness=1.0, metallic=0.0))
    shown = build_object(asset, {})
    config = RelightConfig(resolution=24, samples=64, azimuth_deg=20.0)
    (first,) = relight(shown, [half_sky], tmp_path / "a", config)
    turned = RelightConfig(resolution=24, samples=64, azimuth_deg=130.0, rotation_deg=110.0)
    (second,) = relight(shown, [half_sky], tmp_path / "b", turned)  # The ring itself looks the same from all around.
    (other,) = relight(shown, [half_sky], tmp_path / "c", RelightConfig(resolution=24, samples=64, azimuth_deg=130.0))
    same = np.abs(pixels(first) - pixels(second))[..., :3].mean()
    assert same < 0.02 < np.abs(pixels(first) - pixels(other))[..., :3].mean()


def test_an_environment_that_turns_leaves_the_object_where_it_is(asset, half_sky, tmp_path):
    config = RelightConfig(resolution=24, samples=8, turntable=2, turning="environment")
    start, half = (pixels(path) for path in relight(build_object(asset, {}), [half_sky], tmp_path / "out", config))
    assert np.array_equal(start[..., 3], half[..., 3])
    assert np.abs(start - half)[..., :3].max() > 0.2


def test_environments_side_by_side_are_their_own_pictures_on_the_backdrop(asset, tmp_path):
    shown = build_object(asset, {})
    both = relight(shown, ["forest", "night"], tmp_path / "both", TINY, compare=True)
    assert [path.name for path in both] == ["ring_forest_night_000.png"]
    sheet = pixels(both[0])
    assert sheet.shape == (24, 48, 4) and (sheet[..., 3] == 1.0).all()
    for column, name in enumerate(("forest", "night")):
        single = pixels(relight(shown, [name], tmp_path / "single", TINY)[0])
        solid = single[..., 3] == 1.0
        assert np.abs(sheet[:, 24 * column : 24 * (column + 1)] - single)[solid, :3].max() < 1.5 / 255


def test_a_video_shows_the_pictures_in_their_order(tmp_path):
    greys = (0.2, 0.5, 0.8)
    paths = []
    for grey in greys:
        image = bpy.data.images.new("grey", 33, 32, alpha=True)
        image.pixels.foreach_set(np.tile(np.array([grey, grey, grey, 1.0], dtype=np.float32), 33 * 32))
        paths.append(tmp_path / f"{grey}.png")
        image.filepath_raw, image.file_format = str(paths[-1]), "PNG"
        image.save()
    before = sorted(item.name for item in bpy.data.user_map())
    write_video(tmp_path / "turn.mp4", paths, 3)
    assert sorted(item.name for item in bpy.data.user_map() if item.name != "Render Result") == before
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*(p.name for p in paths), "turn.mp4"])
    movie = bpy.data.movieclips.load(str(tmp_path / "turn.mp4"))
    assert (movie.frame_duration, movie.fps, tuple(movie.size)) == (3, 3.0, (32, 32))
    assert shades(tmp_path / "turn.mp4", 3) == pytest.approx(greys, abs=0.03)


def shades(video, count: int) -> list[float]:
    """The mean of each frame, as Blender's own reader gives it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    movie = bpy.data.images.load(str(video))
    scene, found = bpy.context.scene, []
    strip = sequence_strips(scene).new_movie(name="movie", filepath=str(video), channel=1, frame_start=1)
    assert strip.frame_final_duration == count
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = movie.size
    use_png(scene)
    for frame in range(1, count + 1):
        scene.frame_set(frame)
        scene.render.filepath = str(video.with_suffix(".frame.png"))
        bpy.ops.render.render(write_still=True)
        found.append(float(pixels(scene.render.filepath)[..., :3].mean()))
    return found


def test_eevee_sees_the_environment_by_rays_in_every_blender():
    """What that is worth is measured with a window: tests/ui, scenario "engines"."""
    with temporary_scene("Eevee") as scene:
        use_eevee(scene, 4)
        rays = scene.eevee.ray_tracing_options
        assert scene.render.engine == EEVEE and scene.eevee.use_raytracing and scene.eevee.taa_render_samples == 4
        assert rays.trace_max_roughness == 1.0 and not rays.denoise_temporal


def test_eevee_without_a_graphics_device_is_one_line(asset, tmp_path, monkeypatch):
    monkeypatch.setattr(graphics_device, "_egl_answers", lambda: False)
    with pytest.raises(ArmError, match="Eevee needs a graphics device.*Cycles"):
        relight(build_object(asset, {}), ["forest"], tmp_path / "out", RelightConfig(engine="eevee"))
    assert not (tmp_path / "out").exists()


def test_asking_for_a_device_without_a_driver_does_not_end_the_process(tmp_path):
    """Where Blender would abort; in a process of its own, for the answer of EGL is kept."""
    source = "from arm_blender.blender.relight.graphics_device import check_eevee; check_eevee()"
    environment = os.environ | {"__EGL_VENDOR_LIBRARY_DIRS": str(tmp_path), "LIBGL_DRIVERS_PATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", source], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and "Eevee needs a graphics device" in done.stderr.splitlines()[-1]


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
