"""Photographs are listed as they are; their solved cameras come into the scene, with the ground."""

import numpy as np
import pytest
from PIL import Image

import arm_blender
from arm_blender.report import Report
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.transforms_json import write_transforms

bpy = pytest.importorskip("bpy")
from arm_blender.blender.generate import photograph_rows  # noqa: E402
from arm_blender.blender.input.generation_request import GenerationRequest, read_views, views_folder  # noqa: E402
from arm_blender.blender.input.told_pictures import told_pictures  # noqa: E402
from arm_blender.photographs import intake  # noqa: E402

from ...photographs.quick_solver import photographs, solve_quickly  # noqa: E402
from ...pictures import SIZE, six_pictures  # noqa: E402

pytestmark = pytest.mark.blender


@pytest.fixture
def panel(empty_file):
    arm_blender.register()
    yield bpy.context.scene.arm
    arm_blender.unregister()


@pytest.fixture
def shoe(tmp_path):
    """A folder of seven photographs that know nothing of cameras."""
    folder = tmp_path / "shoe"
    folder.mkdir()
    for index in range(7):
        pixels = np.random.default_rng(index).integers(0, 255, (48, 64, 3), np.uint8)
        Image.fromarray(pixels).save(folder / f"IMG_{index}.jpg")
    return folder


def test_photographs_are_listed_without_cutting_anything_out(panel, shoe):
    panel.views_path = str(shoe)
    assert bpy.ops.arm.look() == {"FINISHED"}
    assert panel.views_kind == "photographs"
    assert [view.name for view in panel.views] == [f"IMG_{index}.jpg" for index in range(7)]


def solved(shoe, doubt=None):
    """Stands in for solving: six views of the rig, standing on a ground."""

    def make(path, folder, options, solving, report, progress):
        assert path == shoe and folder == shoe.with_name("shoe-views")
        six_pictures(folder)
        names, cameras = [f"{i}.png" for i in range(6)], zero123plus_rig(4.0, 30.0, SIZE)
        write_transforms(folder / "transforms.json", names, cameras, ground=-0.75)
        if doubt is not None:
            report.doubt(doubt)
        return folder

    return make


def test_solved_cameras_come_into_the_scene_with_the_ground(panel, shoe, monkeypatch):
    monkeypatch.setattr(intake, "make_views", solved(shoe))
    panel.views_path = str(shoe)
    assert bpy.ops.arm.solve_cameras() == {"FINISHED"}
    cameras = [item for item in bpy.context.scene.objects if item.type == "CAMERA"]
    assert len(cameras) == 6 and all(camera.data.background_images[0].image is not None for camera in cameras)
    assert np.array(cameras[0].matrix_world) == pytest.approx(zero123plus_rig(4.0, 30.0, SIZE)[0].c2w.numpy(), abs=1e-5)
    ground = bpy.data.objects["ARM ground"]
    assert ground.location.z == pytest.approx(-0.75) and ground.hide_render
    assert panel.views_path == str(shoe.with_name("shoe-views")), "the views are what is generated from"
    bpy.ops.arm.look()
    assert panel.views_kind == "posed" and len(panel.views) == 6


def test_a_doubtful_solution_says_so(panel, shoe, monkeypatch, capfd):
    monkeypatch.setattr(intake, "make_views", solved(shoe, "two ways to solve the cameras disagree"))
    panel.views_path = str(shoe)
    bpy.ops.arm.solve_cameras()
    assert "Doubtful: two ways to solve the cameras disagree" in "".join(capfd.readouterr())


def test_nothing_chosen_is_one_line(panel):
    with pytest.raises(RuntimeError, match="Choose pictures first"):
        bpy.ops.arm.solve_cameras()


def rows(panel) -> dict[str, tuple[str, str]]:
    return {row.name: (photograph_rows.icon_of(row), row.short) for row in panel.photographs}


KNOWN = {
    "IMG_0000.png": ("CHECKMARK", "small network"),
    "IMG_0001.png": ("ERROR", "doubtful: it has several parts"),
    "IMG_0002.png": ("CHECKMARK", "small network"),
    "IMG_0003.png": ("X", "its camera could not be solved"),
}


def test_after_solving_each_photograph_has_a_row_that_says_what_became_of_it(panel, tmp_path, monkeypatch):
    cup = photographs(tmp_path / "cup")
    asked = solve_quickly(monkeypatch, cup)
    panel.views_path = str(cup)
    bpy.ops.arm.look()
    assert not panel.photographs, "nothing is known yet"
    assert bpy.ops.arm.solve_cameras() == {"FINISHED"}
    assert bpy.ops.arm.look() == {"FINISHED"}
    assert panel.views_kind == "posed" and rows(panel) == KNOWN
    assert [view.doubt for view in panel.views] == ["", "it has several parts", ""]
    assert "too little in common" in panel.photographs[3].whole and "No view" in panel.photographs[3].whole
    assert "sharpness" in panel.photographs[0].whole
    panel.views_path = str(cup)  # Back to the photographs: what is known of them stays known.
    bpy.ops.arm.look()
    assert panel.views_kind == "photographs" and rows(panel) == KNOWN
    (cup / "IMG_0003.png").unlink()
    bpy.ops.arm.look()
    assert not panel.photographs, "of other pictures nothing is known"
    assert len(asked) == 1


def test_a_painted_mask_is_told_before_the_next_run_and_used_in_it(panel, tmp_path, monkeypatch):
    cup = photographs(tmp_path / "cup")
    asked = solve_quickly(monkeypatch, cup)
    panel.views_path = str(cup)
    bpy.ops.arm.solve_cameras()
    folder = tmp_path / "cup-views"
    assert bpy.ops.arm.edit_mask(picture=str(folder / "IMG_0001.png"), root=str(folder)) == {"FINISHED"}
    bpy.ops.arm.look()
    assert rows(panel)["IMG_0001.png"] == ("CHECKMARK", "painted mask") and panel.views[1].doubt == ""
    report = Report("small", "cpu", 0)
    views = read_views(GenerationRequest(cup), lambda *_: None, report)
    assert len(views.cameras) == 3 and report.masks["painted mask"] == ["IMG_0001.png"] and len(asked) == 1


def test_views_of_photographs_are_kept_beside_them_by_a_run(panel, tmp_path, monkeypatch):
    cup = photographs(tmp_path / "v1.2 cup")
    asked = solve_quickly(monkeypatch, cup)
    for _ in range(2):
        read_views(GenerationRequest(cup), lambda *_: None, Report("small", "cpu", 0))
    assert len(asked) == 1 and len(told_pictures(tmp_path / "v1.2 cup-views")) == 4
    assert views_folder(tmp_path / "walk.mov") == tmp_path / "walk-views"


@pytest.mark.parametrize("text", [None, "{", "[]", '{"source": {}, "facts": {}, "left_out": 3}'])
def test_a_record_that_is_missing_or_damaged_tells_nothing(tmp_path, text):
    if text is not None:
        (tmp_path / "cameras.json").write_text(text)
    assert told_pictures(tmp_path) == ()
