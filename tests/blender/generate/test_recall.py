"""What the command line made can be recalled in Blender, and asked for again, wherever its file is by then."""

import json
from pathlib import Path

import numpy as np
import pytest

import arm_blender
from arm_blender import pipeline
from arm_blender.__main__ import main
from arm_blender.asset_record import read_record
from arm_blender.knobs import Knobs, ViewKnobs, knobs_of
from arm_blender.structures import RelightableAsset

bpy = pytest.importorskip("bpy")
from arm_blender.blender.input import request  # noqa: E402

from ...pictures import six_pictures  # noqa: E402
from ...test_asset_record import OF_THE_COMMAND_LINE, OF_THE_PANEL  # noqa: E402

pytestmark = pytest.mark.blender

WORDS = "--quality draft --seed 5 --faces 700 --texture-size 512 --normal-map --dense --precision float32"
WORDS += " --rig-distance 3.5 --fovy 40 --view-weights 1,0,1,1,2.5,1 --place ground --progress never"


@pytest.fixture
def panel(empty_file):
    arm_blender.register()
    yield bpy.context.scene.arm
    arm_blender.unregister()


@pytest.fixture(params=["generate", "batch"])
def run(request, empty_file, monkeypatch, asset, tmp_path):
    """What the command line's run was given, and the .blend that it wrote."""
    given = {}

    def generate(views, settings, progress, report, mesh):
        given.update(views=views, settings=settings)
        return RelightableAsset(views.name, asset.mesh, asset.maps), report

    monkeypatch.setattr(pipeline, "generate", generate)
    monkeypatch.chdir(tmp_path)  # What is relative to it is not relative to the .blend.
    (tmp_path / "first").mkdir()
    six_pictures(tmp_path / "first" / "cup")
    Path("list.txt").write_text("first/cup\n")
    what = "first/cup" if request.param == "generate" else "list.txt"
    assert main([request.param, what, "--output", "first/out", *WORDS.split()]) == 0
    given["blend"] = next((tmp_path / "first" / "out").rglob("cup.blend"))
    return given


def appended(path: Path):
    """The object of a .blend in the open file, active."""
    with bpy.data.libraries.load(str(path), link=False) as (_, wanted):
        wanted.objects = ["cup"]
    (found,) = wanted.objects
    bpy.context.scene.collection.objects.link(found)
    bpy.context.view_layer.objects.active = found
    return found


def kept_of(holder, declared) -> dict:
    return {one.name: getattr(holder, one.name) for one in knobs_of(declared) if one.kept}


def test_what_the_command_line_made_is_recalled(run, panel, tmp_path):
    appended(run["blend"])
    panel.elevation = -40.0  # The command line said nothing of it.
    assert bpy.ops.arm.recall() == {"FINISHED"}
    assert Path(panel.views_path) == tmp_path / "first" / "cup" and panel.source == "FILES"
    bpy.ops.arm.look()
    asked = request.from_panel(bpy.context)
    of_the_command_line_alone = {"dense": False, "precision": "auto"}
    assert kept_of(asked, Knobs) == kept_of(run["settings"], Knobs) | of_the_command_line_alone
    assert (asked.rig_distance, asked.elevation_deg, asked.fovy_deg) == (3.5, 10.0, 40.0)
    assert asked.weights == (1.0, 0.0, 1.0, 1.0, 2.5, 1.0)


def test_its_appearance_is_asked_for_with_all_that_it_was_made_with(run, panel, asset, tmp_path):
    appended(run["blend"])
    asked = request.from_result(bpy.context)
    assert asked.views == tmp_path / "first" / "cup" and asked.mesh_in_place
    assert kept_of(asked, Knobs) == kept_of(run["settings"], Knobs)
    views = {"rig_distance": 3.5, "fovy_deg": 40.0, "weights": (1.0, 0.0, 1.0, 1.0, 2.5, 1.0)}
    assert kept_of(asked, ViewKnobs) == kept_of(ViewKnobs(), ViewKnobs) | views
    # It stands on the ground; the cameras see it where the run put it.
    assert np.sort(asked.mesh.vertices, axis=0) == pytest.approx(np.sort(asset.mesh.vertices.numpy(), axis=0), abs=1e-5)


def test_a_file_that_moved_with_its_views_finds_them(run, tmp_path):
    (tmp_path / "first").rename(tmp_path / "second")
    moved = tmp_path / "second" / run["blend"].relative_to(tmp_path / "first")
    bpy.ops.wm.open_mainfile(filepath=str(moved))
    assert request.stored_record(bpy.data.objects["cup"]).views == tmp_path / "second" / "cup"


def test_what_six_drawn_views_made_names_them_and_not_the_picture(empty_file, monkeypatch, asset, tmp_path):
    """They lie beside the result, with their cameras; nobody draws them again."""
    from arm_blender.photographs import intake
    from arm_blender.views import load_views

    six = six_pictures(tmp_path / "six")
    monkeypatch.setattr(intake, "load_views", lambda *given: load_views(six))
    monkeypatch.setattr(pipeline, "generate", lambda views, settings, progress, report, mesh: (asset, report))
    out = tmp_path / "out"
    words = ["--multiview", "zero123plus", "--multiview-model", str(tmp_path), "--progress", "never"]
    assert main(["generate", str(six / "0.png"), "--output", str(out), *words]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(out / "ring.blend"))
    kept = request.stored_record(bpy.data.objects["ring"])
    assert kept.views == out / "views" and kept.chosen["multiview"] == "none"


def test_objects_of_before_recall_what_they_have(panel):
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    cube["arm_settings"] = json.dumps(OF_THE_COMMAND_LINE)
    panel.views_path, panel.fovy = "/other", 25.0
    assert bpy.ops.arm.recall() == {"FINISHED"}
    assert (panel.preset, panel.quality, panel.seed, panel.faces) == ("paper", "final", 4, 700)
    assert (panel.own_weights, panel.views_path, panel.fovy) == ("/trained", "/other", 25.0)
    with pytest.raises(RuntimeError, match="Cube: was not made by this panel; choose Selected Mesh"):
        bpy.ops.arm.regenerate()
    cube["arm_settings"], cube["arm_frame"] = json.dumps(OF_THE_PANEL), [2.0, 1.0, 2.0, 3.0]
    assert bpy.ops.arm.recall() == {"FINISHED"}
    assert (panel.preset, panel.quality, panel.seed, panel.texture_size) == ("small", "draft", 5, "512")
    assert (panel.views_path, panel.fovy, panel.normal_map) == ("/pictures/cup", 40.0, True)
    assert [(view.use, view.weight) for view in panel.views] == [(True, 1.0), (False, 1.0), (True, 2.5)]
    asked = request.from_result(bpy.context)
    assert asked.mesh.vertices.max(axis=0) == pytest.approx([3.0, 4.0, 5.0]), "a cube of 2, twice as large there"
    assert asked.views == Path("/pictures/cup") and asked.weights == (1.0, 0.0, 2.5)
    assert read_record("Cube", cube["arm_settings"], None).frame is None
