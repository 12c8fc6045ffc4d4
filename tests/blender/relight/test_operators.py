"""Relighting and exporting by the extension's operators, without a window: as from a script."""

import math
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from torch.nn import functional

import arm_blender
from arm_blender.structures import MaterialMaps, RelightableAsset

bpy = pytest.importorskip("bpy")
from arm_blender.blender.asset.object_asset import asset_from_object  # noqa: E402
from arm_blender.blender.asset.scene import build_object  # noqa: E402
from arm_blender.blender.relight import callbacks, panel  # noqa: E402
from arm_blender.blender.relight.operators import PICTURE  # noqa: E402

pytestmark = pytest.mark.blender

ROOT = Path(arm_blender.__file__).parents[1]


@pytest.fixture
def settings(empty_file, tmp_path):
    arm_blender.register()
    chosen = bpy.context.scene.arm_relight
    chosen.resolution, chosen.samples, chosen.output = 16, 1, str(tmp_path / "out")
    chosen.environment = "forest"
    yield chosen
    arm_blender.unregister()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_still_is_one_picture_and_is_shown(settings, asset, tmp_path):
    build_object(asset, {})
    assert bpy.ops.arm.relight() == {"FINISHED"}
    assert names(tmp_path / "out") == ["ring_forest_000.png"]
    assert tuple(bpy.data.images[PICTURE].size) == (16, 16)
    settings.resolution, settings.compare, settings.second = 24, True, "night"
    assert bpy.ops.arm.relight("INVOKE_DEFAULT") == {"FINISHED"}
    assert "ring_forest_night_000.png" in names(tmp_path / "out")
    assert (
        tuple(bpy.data.images[PICTURE].size) == (48, 24) and len([i for i in bpy.data.images if PICTURE in i.name]) == 1
    )


def drawn(shown) -> str:
    """What the panels say of an object."""
    said = []
    layout = types.SimpleNamespace(label=lambda text, icon: said.append(text), operator=lambda *_, **__: layout)
    layout.column, layout.prop = lambda **_: layout, lambda *_, **__: None
    layout.template_icon = lambda *_, **__: None
    context = types.SimpleNamespace(
        scene=bpy.context.scene,
        active_object=shown,
        preferences=types.SimpleNamespace(system=types.SimpleNamespace(ui_scale=1.0)),  # 0 without a window.
        region=types.SimpleNamespace(width=280),
    )
    for kind in (panel.ARM_PT_relight, panel.ARM_PT_export):
        kind.draw(types.SimpleNamespace(layout=layout), context)
    return " ".join(said)


def test_the_panels_tell_what_is_missing_and_nothing_else(settings, asset):
    for nothing in (None, bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))):
        assert "select a mesh, to relight it" in drawn(nothing) and "select a mesh, to export it" in drawn(nothing)
    made = build_object(asset, {})
    assert drawn(made) == ""
    settings.output = "//relight/"
    assert drawn(made) == "Save the file, or choose another folder"


def test_a_sequence_is_a_full_turn_and_its_video(settings, asset, tmp_path):
    build_object(asset, {})
    settings.turntable, settings.video, settings.turning = 3, True, "environment"
    assert bpy.ops.arm.relight(what="SEQUENCE") == {"FINISHED"}
    assert names(tmp_path / "out") == ["ring_forest.mp4", *(f"ring_forest_00{turn}.png" for turn in range(3))]


def test_the_menu_of_environments_is_drawn_without_a_look_at_the_disk(monkeypatch):
    first = list(callbacks.environments(None, None))
    monkeypatch.setattr(Path, "glob", lambda *_: pytest.fail("the disk was asked"))
    assert callbacks.environments(None, None) == first
    found = [name for name, _, _ in first]
    assert {"city", "forest", "studio"} < set(found)
    assert found[-2:] == [callbacks.FROM_FILE, callbacks.FROM_VIEWS]


def test_what_is_missing_is_said_and_the_scene_stays(settings, asset, tmp_path):
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.arm.relight()
    build_object(asset, {})
    before = sorted(item.name for item in bpy.data.user_map())
    for name, value, line in (
        ("output", "//relight/", "Save the file first"),
        ("environment", "FILE", "Choose the environment's file"),
    ):
        kept = getattr(settings, name)
        setattr(settings, name, value)
        with pytest.raises(RuntimeError, match=line):
            bpy.ops.arm.relight()
        setattr(settings, name, kept)
    settings.environment, settings.environment_file = "FILE", str(tmp_path / "gone.hdr")
    with pytest.raises(RuntimeError, match="gone.hdr: no such environment"):
        bpy.ops.arm.relight()
    with pytest.raises(RuntimeError, match="gone.hdr: no such environment"):
        bpy.ops.arm.light_scene()
    assert sorted(item.name for item in bpy.data.user_map()) == before and not (tmp_path / "out").exists()


def test_the_scene_is_lit_and_its_light_follows_the_rotation(settings, asset):
    world = bpy.data.worlds.new("mine")
    bpy.context.scene.world = world
    assert bpy.ops.arm.light_scene() == {"FINISHED"}
    lit = bpy.context.scene.world
    assert lit.name.startswith("forest") and world.use_fake_user
    settings.rotation = math.radians(40.0)
    mapping = next(node for node in lit.node_tree.nodes if node.type == "MAPPING")
    assert math.degrees(mapping.inputs["Rotation"].default_value[2]) == pytest.approx(-40.0, abs=1e-3)
    bpy.context.scene.world = world
    settings.rotation = 0.0  # A world of the user's is left alone.


@pytest.fixture
def detailed(asset) -> RelightableAsset:
    """The ring with a normal map, and metallic as one value."""
    generator = torch.Generator().manual_seed(5)
    normal = functional.normalize(
        torch.rand(3, 16, 16, generator=generator) + torch.tensor([-0.5, -0.5, 1])[:, None, None], dim=0
    )
    maps = asset.maps
    return RelightableAsset("ring", asset.mesh, MaterialMaps(maps.albedo, maps.baked, maps.roughness, 0.25, normal))


def test_an_object_is_the_asset_that_it_was_built_of(settings, detailed):
    built = build_object(detailed, {})
    built.location, built.scale = (1.0, 2.0, 3.0), (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    found = asset_from_object(built)
    corners = 2.0 * detailed.mesh.vertices[detailed.mesh.faces] + torch.tensor([1.0, 2.0, 3.0])
    torch.testing.assert_close(found.mesh.vertices[found.mesh.faces], corners, atol=1e-5, rtol=0.0)
    uvs = detailed.mesh.uvs[detailed.mesh.face_uvs]
    torch.testing.assert_close(found.mesh.uvs[found.mesh.face_uvs], uvs, atol=1e-6, rtol=0.0)
    torch.testing.assert_close(found.maps.albedo, detailed.maps.albedo, atol=0.012, rtol=0.0)
    torch.testing.assert_close(found.maps.baked, detailed.maps.baked, atol=0.012, rtol=0.0)
    torch.testing.assert_close(found.maps.roughness, detailed.maps.roughness, atol=0.51 / 255, rtol=0.0)
    torch.testing.assert_close(found.maps.normal, detailed.maps.normal, atol=1.02 / 255, rtol=0.0)
    assert found.maps.metallic == 0.25


def test_a_mirrored_object_keeps_its_outside(settings, asset):
    built = build_object(asset, {})
    volume = signed_volume(asset_from_object(built).mesh)
    built.scale = (-1.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    assert volume > 0 and signed_volume(asset_from_object(built).mesh) == pytest.approx(volume, rel=1e-4)


def signed_volume(mesh) -> float:
    a, b, c = mesh.vertices[mesh.faces].unbind(dim=1)
    return float((a * torch.linalg.cross(b, c)).sum()) / 6.0


def test_exporting_writes_every_format_that_was_asked_for(settings, detailed, tmp_path):
    build_object(detailed, {})
    assert bpy.ops.arm.export(directory=str(tmp_path), formats={"glb", "usd", "obj"}) == {"FINISHED"}
    textures = [f"{name}.png" for name in ("albedo", "baked", "metallic", "normal", "roughness")]
    assert names(tmp_path / "ring") == ["ring.glb", "ring.mtl", "ring.obj", "ring.usda", "textures"]
    assert names(tmp_path / "ring" / "textures") == textures
    found = trimesh.load(tmp_path / "ring" / "ring.glb", force="mesh")
    np.testing.assert_allclose(found.extents, [2.0, 0.6, 2.0], atol=1e-5)


def test_what_cannot_be_exported_is_one_line(settings, asset, tmp_path):
    built = build_object(asset, {})
    built.data.materials.clear()
    with pytest.raises(RuntimeError, match="ring: has no material"):
        bpy.ops.arm.export(directory=str(tmp_path))
    built.data.uv_layers.remove(built.data.uv_layers[0])
    built.data.update()
    with pytest.raises(RuntimeError, match="ring: has no UV map"):
        bpy.ops.arm.export(directory=str(tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_a_script_whose_generation_fails_ends_with_an_error(tmp_path):
    """`blender --background --python-exit-code 1 --python script.py`: an exception is what the exit code is made of."""
    source = (
        f"import arm_blender, bpy; arm_blender.register(); bpy.ops.arm.generate(filepath={str(tmp_path / 'no.png')!r})"
    )
    done = subprocess.run([sys.executable, "-c", source], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1 and "no.png" in done.stderr.strip().splitlines()[-1], done.stderr
