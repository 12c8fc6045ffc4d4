"""The extension comes and goes without a trace, runs blocking without a window, and hands on what the user chose."""

import json
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest
import torch

import arm_blender
from arm_blender.errors import Cancelled, InputImageError
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.structures import ViewSet
from arm_blender.views.scene_frame import IDENTITY

bpy = pytest.importorskip("bpy")
from arm_blender.blender import cli  # noqa: E402
from arm_blender.blender.generate import generation, operators  # noqa: E402

pytestmark = pytest.mark.blender

ROOT = Path(arm_blender.__file__).parents[1]


@pytest.fixture
def extension(empty_file):
    arm_blender.register()
    yield
    arm_blender.unregister()


@pytest.fixture
def answer(monkeypatch, asset):
    """Puts another pipeline behind the operator; gives the requests that reach it."""
    requests = []

    def pipeline(request, progress):
        requests.append(request)
        progress(0.5, "half way")
        return generation.Generated(asset, types.SimpleNamespace(as_dict=lambda: {"faces": 576}), IDENTITY)

    monkeypatch.setattr(operators, "generate", pipeline)
    return requests


def ours() -> list[str]:
    kinds = (bpy.types.Operator, bpy.types.Panel, bpy.types.PropertyGroup, bpy.types.AddonPreferences)
    return [cls.__name__ for kind in kinds for cls in kind.__subclasses__() if cls.is_registered and "ARM_" in str(cls)]


def test_registering_twice_leaves_nothing_behind(empty_file):
    registered = []
    for _ in range(2):
        arm_blender.register()
        registered.append(ours())
        assert bpy.context.scene.arm.preset == "small"
        arm_blender.unregister()
    first, again = registered
    assert first == again and len(set(first)) == len(first) and {"ARM_OT_generate", "ARM_PT_advanced"} < set(first)
    assert ours() == []
    assert not hasattr(bpy.types.Scene, "arm") and not hasattr(bpy.types.WindowManager, "arm")
    assert not hasattr(bpy.types.Material, "arm_view")
    assert not hasattr(bpy.types, "ARM_OT_generate")


def test_generating_in_the_background_waits_for_the_object(extension, answer, tmp_path):
    scene = bpy.context.scene.arm
    scene.texture_size, scene.faces, scene.seed, scene.placement = "1024", 5000, 7, "ground"
    scene.normal_map = True
    scene.size, bpy.context.scene.cursor.location = 0.5, (3.0, -2.0, 5.0)
    assert bpy.ops.arm.generate("INVOKE_DEFAULT", filepath=str(tmp_path)) == {"FINISHED"}
    made = bpy.context.object
    assert (made.name, len(made.data.polygons)) == ("ring", 576)
    assert tuple(made.location) == (3.0, -2.0, 0.0) and max(made.dimensions) == pytest.approx(0.5)
    assert min(corner[2] for corner in made.bound_box) == pytest.approx(0.0, abs=1e-6)
    (request,) = answer
    assert request.views == tmp_path
    assert (request.texture_size, request.faces, request.seed, request.normal_map) == (1024, 5000, 7, True)
    kept = json.loads(made["arm_settings"])
    assert kept["report"] == {"faces": 576} and kept["views"] == str(tmp_path) and kept["texture_size"] == 1024
    assert set(kept["versions"]) == {"arm", "blender", "torch"}
    assert not operators.is_running()


def test_what_is_left_to_the_quality_reaches_the_pipeline_as_none(extension, answer, tmp_path):
    bpy.context.scene.arm.views_path = str(tmp_path)
    bpy.ops.arm.generate()
    assert (answer[0].texture_size, answer[0].faces) == (None, None)
    assert answer[0].threads >= 1


@pytest.mark.parametrize(
    "error, shown",
    [
        (InputImageError("mug.png: no foreground found; supply alpha"), "mug.png: no foreground found"),
        (RuntimeError("shape (3, 4)"), r"Internal error: RuntimeError: shape \(3, 4\)"),
    ],
)
def test_an_error_is_reported_and_nothing_is_made(extension, monkeypatch, tmp_path, error, shown):
    def failing(request, progress):
        raise error

    monkeypatch.setattr(operators, "generate", failing)
    with pytest.raises(RuntimeError, match=shown):
        bpy.ops.arm.generate(filepath=str(tmp_path))
    assert len(bpy.data.objects) == 0
    assert re.match(shown, bpy.context.window_manager.arm.error)


def test_a_failure_stays_in_the_panel_until_the_next_run(extension, answer, tmp_path):
    with pytest.raises(RuntimeError):
        bpy.ops.arm.generate()
    assert "Choose pictures first" in bpy.context.window_manager.arm.error
    bpy.ops.arm.generate(filepath=str(tmp_path))
    assert bpy.context.window_manager.arm.error == ""


@pytest.mark.parametrize("mode", ["EDIT", "SCULPT"])
def test_a_result_that_arrives_in_another_mode_changes_neither_mode_nor_selection(extension, answer, tmp_path, mode):
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    bpy.ops.object.mode_set(mode=mode)
    assert bpy.ops.arm.generate(filepath=str(tmp_path)) == {"FINISHED"}
    assert (cube.mode, bpy.context.object, list(bpy.context.selected_objects)) == (mode, cube, [cube])
    assert "ring" in bpy.context.scene.objects


@pytest.mark.parametrize(("size", "hider"), [(4.0, "Cube"), (0.5, "")])
def test_what_hides_a_new_result_is_said(extension, answer, tmp_path, size, hider):
    bpy.ops.mesh.primitive_cube_add(size=size)
    bpy.ops.arm.generate(filepath=str(tmp_path))
    state = bpy.context.window_manager.arm
    assert (state.newest, state.hidden_by) == ("ring", hider)


def test_a_cancelled_generation_makes_nothing_and_is_no_error(extension, monkeypatch, tmp_path):
    def cancelled(request, progress):
        raise Cancelled("stopped by the user")

    monkeypatch.setattr(operators, "generate", cancelled)
    assert bpy.ops.arm.generate(filepath=str(tmp_path)) == {"CANCELLED"}
    assert len(bpy.data.objects) == 0


def test_without_views_the_user_is_told_what_to_do(extension):
    with pytest.raises(RuntimeError, match="Choose pictures first"):
        bpy.ops.arm.generate()


def test_settings_stay_with_the_file_and_progress_does_not(extension, tmp_path):
    bpy.context.scene.arm.seed = 11
    bpy.context.window_manager.arm.fraction = 0.5
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    bpy.context.scene.arm.seed = 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "work.blend"))
    assert bpy.context.scene.arm.seed == 11
    assert bpy.types.WindowManager.bl_rna.properties["arm"].fixed_type.properties["fraction"].is_skip_save


def test_the_command_hands_its_words_to_the_command_line(monkeypatch):
    words = []

    def main(argv):
        words.append(argv)
        return 2

    monkeypatch.setitem(sys.modules, "arm_blender.__main__", types.SimpleNamespace(main=main))
    assert cli.run(["generate", "mug.png"]) == 2
    assert words == [["generate", "mug.png"]]


def test_request_and_worker_know_nothing_of_bpy():
    modules = ", ".join(
        f"arm_blender.blender.{name}" for name in ("generate.generation", "generate.remaining", "input.looking", "job")
    )
    source = f"import sys, {modules}; print('bpy' in sys.modules, 'torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", source], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False False"


def test_registering_imports_nothing_but_ourselves_and_the_standard_library():
    source = """
import sys, bpy
before = set(sys.modules)
import arm_blender
arm_blender.register()
added = {name.partition(".")[0] for name in set(sys.modules) - before}
print(sorted(added - set(sys.stdlib_module_names) - {"bpy"}))
"""
    done = subprocess.run([sys.executable, "-c", source], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['arm_blender']"


def test_a_request_becomes_settings_and_one_rising_progress(monkeypatch, tmp_path, asset):
    from arm_blender import pipeline
    from arm_blender.photographs import intake

    seen = {}
    images = torch.zeros(1, 4, 16, 16)
    images[:, :, 4:12, 4:12] = 1.0
    views = ViewSet(images, (orbit_camera(0.0, 0.0, 4.0, 45.0, 16, 16),), torch.ones(1), "ring")

    def load_views(path, folder, options, solving, report, progress):
        progress(1.0, "loaded")
        report.leave_out("view 3", "sees nothing")
        seen.update(path=path, options=options)
        return views

    def generate(loaded, settings, progress, report, mesh):
        seen.update(loaded=loaded, settings=settings, mesh=mesh)
        progress(0.5, "half way")
        progress(1.0, "done")
        return asset, report

    monkeypatch.setattr(intake, "load_views", load_views)
    monkeypatch.setattr(pipeline, "generate", generate)
    fractions = []
    request = generation.GenerationRequest(
        tmp_path,
        weights=(1.0, 0.0),
        elevation_deg=20.0,
        quality="draft",
        texture_size=256,
        faces=500,
        normal_map=True,
        seed=9,
        threads=1,
    )
    made = generation.generate(request, lambda fraction, message: fractions.append(fraction))
    assert (made.asset.name, seen["path"], seen["mesh"]) == ("ring", tmp_path, None) and seen["loaded"] is views
    assert torch.equal(made.asset.mesh.vertices, asset.mesh.vertices)
    assert (seen["options"].weights, seen["options"].elevation_deg) == ((1.0, 0.0), 20.0)
    settings = seen["settings"]
    assert (settings.quality, settings.texture_size, settings.faces) == ("draft", 256, 500)
    assert settings.normal_map
    assert (settings.seed, settings.threads, made.report.seed) == (9, 1, 9)
    assert made.report.as_dict()["left_out"] == [{"what": "view 3", "why": "sees nothing"}]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
