"""What is set of regions is asked for again: by *Recall Settings*, and by *Regenerate Appearance*."""

import json

import pytest

from arm_blender.knobs.finishes import PRESETS, Finish
from arm_blender.structures import RelightableAsset

from ...test_asset_record import OF_THE_COMMAND_LINE

bpy = pytest.importorskip("bpy")
from arm_blender.blender.asset.finish_nodes import finishes, set_finish  # noqa: E402
from arm_blender.blender.asset.scene import build_object, replace_maps  # noqa: E402
from arm_blender.blender.input import request  # noqa: E402

pytestmark = pytest.mark.blender


@pytest.fixture
def kept(shown):
    shown["arm_settings"] = json.dumps(OF_THE_COMMAND_LINE)
    set_finish(shown.active_material, 1, Finish(0.25, 1.0, PRESETS["gold"].f0))
    set_finish(shown.active_material, 2, PRESETS["rubber"])
    return shown


def test_recall_fills_the_knob_with_what_is_set_now(kept):
    panel = bpy.context.scene.arm
    assert bpy.ops.arm.recall() == {"FINISHED"}
    assert panel.finish == "1=gold/0.25/1,2=rubber"
    panel.views_path = "/pictures/cup"
    assert request.from_panel(bpy.context).finish == "1=gold/0.25/1,2=rubber"
    bpy.ops.arm.reset_finishes()
    assert bpy.ops.arm.recall() == {"FINISHED"}
    assert panel.finish == "" and request.from_panel(bpy.context).finish is None


def test_a_new_appearance_is_asked_for_with_it(kept):
    assert request.stored_record(kept).chosen["finish"] == "1=gold/0.25/1,2=rubber"


def test_a_record_of_before_there_were_regions_is_read_as_it_is(kept, tile):
    old = build_object(RelightableAsset("old", tile.mesh, tile.maps), OF_THE_COMMAND_LINE)
    del old.active_material["arm_regions"]
    assert request.stored_record(old).chosen["finish"] is None


def test_new_maps_come_with_what_is_set_of_them_and_leave_no_table_behind(kept, tile):
    replace_maps(kept, tile.maps, {})
    assert finishes(kept.active_material) == {} and not bpy.data.node_groups
