"""The example is two clicks away, and undo gives back what was chosen before."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import arm_blender

bpy = pytest.importorskip("bpy")
from arm_blender.blender.input import request  # noqa: E402
from arm_blender.blender.input.example_operator import EXAMPLE  # noqa: E402

pytestmark = pytest.mark.blender

ROOT = Path(arm_blender.__file__).parents[1]


@pytest.fixture
def panel(empty_file):
    arm_blender.register()
    yield bpy.context.scene.arm
    arm_blender.unregister()


def test_the_button_takes_six_views_with_cameras_and_generate_needs_nothing_else(panel):
    panel.source, panel.shape = "CAMERAS", "MESH"
    assert bpy.ops.arm.load_example() == {"FINISHED"}
    wanted = request.from_panel(bpy.context)
    assert (wanted.views, wanted.mesh, wanted.preset) == (EXAMPLE, None, "small")
    assert bpy.ops.arm.look() == {"FINISHED"}
    assert (panel.views_kind, [view.name for view in panel.views]) == ("posed", [f"{i:03}.png" for i in range(6)])
    assert all(view.sees and view.use for view in panel.views)


def test_undo_gives_back_the_choice_before(tmp_path):
    """In a process of its own: an undo as a Python module wants a fresh start."""
    program = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
import arm_blender
arm_blender.register()
settings = bpy.context.scene.arm
settings.source, settings.views_path, settings.shape = "FILES", {str(tmp_path)!r}, "MESH"
bpy.ops.ed.undo_push(message="chosen")
assert bpy.ops.arm.load_example("EXEC_DEFAULT", True) == {{"FINISHED"}}
assert bpy.context.scene.arm.views_path.endswith("barrel")
bpy.ops.ed.undo()
settings = bpy.context.scene.arm
assert (settings.views_path, settings.shape) == ({str(tmp_path)!r}, "MESH"), settings.views_path
bpy.ops.ed.redo()
assert bpy.context.scene.arm.views_path.endswith("barrel")
assert not {{"torch"}} & set(sys.modules), "the button waits for no network"
print("works")
"""
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert done.stdout.strip().endswith("works"), done.stdout + done.stderr
