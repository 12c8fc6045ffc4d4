"""What the user is refused: by the whole program, in one line with the remedy, and nothing in the scene is lost."""

import json
from pathlib import Path

import pytest
import torch

import arm_blender
from arm_blender.config import Settings
from arm_blender.views.image_io import write_png

from ...pictures import a_picture

bpy = pytest.importorskip("bpy")

pytestmark = pytest.mark.blender


@pytest.fixture
def panel(empty_file):
    arm_blender.register()
    bpy.ops.mesh.primitive_cube_add()
    yield bpy.context.scene.arm
    arm_blender.unregister()


@pytest.fixture
def picture(tmp_path) -> Path:
    return a_picture(tmp_path / "cup.png")


def everything() -> dict[str, list]:
    kinds = ("scenes", "objects", "meshes", "materials", "images", "collections", "cameras")
    found = {kind: sorted(item.name for item in getattr(bpy.data, kind)) for kind in kinds}
    cube = bpy.data.objects["Cube"]
    return found | {"mode": cube.mode, "vertices": len(cube.data.vertices), "selected": cube.select_get()}


def refused(operator, match: str) -> None:
    """The operator ends in one line that the panel keeps, and the scene is as it was."""
    before = everything()
    with pytest.raises(RuntimeError, match=match):
        operator()
    line = bpy.context.window_manager.arm.error
    assert line and "\n" not in line and "Traceback" not in line and "Internal error" not in line
    assert everything() == before


def empty_picture(panel, picture):
    write_png(picture, torch.zeros(4, 64, 64), srgb=True)


def no_picture(panel, picture):
    picture.write_bytes(b"not a picture")


def gone(panel, picture):
    picture.unlink()


def no_weights(panel, picture):
    panel.preset = "paper"


def no_folder(panel, picture):
    panel.own_weights = str(picture.parent / "none")


def no_own_weights(panel, picture):
    panel.own_weights = str(picture.parent)


def no_cameras(panel, picture):
    panel.source = "CAMERAS"


def edited(panel, picture):
    panel.shape = "MESH"
    bpy.ops.object.mode_set(mode="EDIT")


def without_faces(panel, picture):
    panel.shape = "MESH"
    bpy.ops.object.modifier_add(type="MASK")
    bpy.context.object.modifiers[0].vertex_group = bpy.context.object.vertex_groups.new(name="none").name


def all_ticked_off(panel, picture):
    bpy.ops.arm.look()
    panel.views[0].use = False


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (gone, "cup.png: no such file"),
        (no_picture, "cup.png: not a readable picture; give a PNG"),
        (empty_picture, "cup.png: the mask is empty"),
        (no_weights, "paper.glossyrm.safetensors|paper.georm.safetensors"),
        (no_folder, "none: no such folder; name one that holds small.georm.safetensors"),
        (no_own_weights, "holds none of small.georm.safetensors, .*; name the trained files so"),
        (no_cameras, "No camera of the scene has a background image; add one"),
        (edited, r"Cube: is being edited; go back to Object Mode \(Tab\)"),
        (without_faces, "Cube: has no faces"),
        (all_ticked_off, "cup.png: every view that shows something has weight 0"),
    ],
)
def test_each_is_one_line_and_nothing_is_lost(panel, picture, spoil, match):
    panel.views_path = str(picture)
    spoil(panel, picture)
    refused(bpy.ops.arm.generate, match)


def test_no_image_is_one_line(panel):
    refused(bpy.ops.arm.generate, "Choose pictures first, or press Example")


def test_regenerating_what_is_no_result_is_one_line(panel):
    refused(bpy.ops.arm.regenerate, "Cube: was not made by this panel; choose Selected Mesh")


def test_missing_weights_are_said_for_regenerate_as_well(panel, picture, monkeypatch, tmp_path):
    """The file of the weights may go after the object was made; its appearance stays as it is."""
    from arm_blender.blender.input.generation_request import GenerationRequest

    cube = bpy.context.object
    cube["arm_settings"] = json.dumps(GenerationRequest(picture).record((1.0, 0.0, 0.0, 0.0)).as_json(None))
    monkeypatch.setattr(Settings, "weights", lambda settings, name: tmp_path / "gone.safetensors")
    refused(bpy.ops.arm.regenerate, "gone.safetensors")
