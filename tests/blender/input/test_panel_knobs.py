"""Every knob that is to be shown is a property of the panel, and says there and back what it is."""

from pathlib import Path

import pytest

import arm_blender
from arm_blender.knobs import DrawingKnobs, Knobs, ViewKnobs, knobs_of

bpy = pytest.importorskip("bpy")
from arm_blender.blender.input.panel_knobs import panel_values, set_panel  # noqa: E402

pytestmark = pytest.mark.blender

CLASSES = (Knobs, ViewKnobs, DrawingKnobs)
NOT_SHOWN = {"grid", "dense", "precision", "time_limit", "random_weights", "rig", "multiview"}
NOT_SHOWN |= {"guidance", "background", "reseed"}  # Few need them: of the command line alone.
NOT_SHOWN |= {"weights"}  # In the list of views.
NOT_SHOWN |= {"cameras_from", "length", "photo_views", "refinement"}  # Of the command line so far.
NOT_SHOWN |= {"device", "threads"}  # In the preferences.


@pytest.fixture
def panel(empty_file):
    arm_blender.register()
    yield bpy.context.scene.arm
    arm_blender.unregister()


def test_what_is_not_shown_is_known(panel):
    found = [one for declared in CLASSES for one in knobs_of(declared)]
    assert {one.name for one in found if one.shown is None} == NOT_SHOWN
    for one in found:
        if one.shown is not None:
            made = panel.bl_rna.properties[one.shown.name or one.name]
            assert (made.name, made.description) == (one.shown.title, one.shown.tip)


def test_the_panel_begins_at_the_defaults(panel):
    assert panel_values(panel, Knobs) == {
        "preset": "small",
        "weights_folder": None,
        "quality": "balanced",
        "texture_size": None,
        "faces": None,
        "seed": 0,
        "normal_map": False,
        "finish": None,
    }
    # The panel says what the command line leaves to the views.
    assert panel_values(panel, ViewKnobs) == {"rig_distance": 4.0, "elevation_deg": 10.0, "fovy_deg": 30.0}
    assert panel_values(panel, DrawingKnobs) == {"steps": 28}


def test_values_come_back_as_they_were_set(panel):
    values = {
        "preset": "paper",
        "weights_folder": Path("/some/where"),
        "quality": "final",
        "texture_size": 2048,
        "faces": 700,
        "seed": 3,
        "normal_map": True,
        "finish": "2=chrome,3=0.3/1",
    }
    set_panel(panel, Knobs, values)
    assert panel_values(panel, Knobs) == values
    nothing = {name: None for name in ("weights_folder", "texture_size", "faces", "finish")}
    set_panel(panel, Knobs, nothing)
    assert panel_values(panel, Knobs) == values | nothing
    set_panel(panel, ViewKnobs, {"elevation_deg": -20.0, "fovy_deg": None, "rig_distance": 2.5})
    assert panel_values(panel, ViewKnobs) == {"rig_distance": 2.5, "elevation_deg": -20.0, "fovy_deg": 30.0}


def test_what_the_panel_cannot_show_is_left_to_the_quality(panel):
    panel.texture_size = "512"
    set_panel(panel, Knobs, {"texture_size": 4096})
    assert panel_values(panel, Knobs)["texture_size"] is None
