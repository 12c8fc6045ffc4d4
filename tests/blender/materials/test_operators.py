"""What the panel's buttons and sliders do, each in one step that can be undone, and what they refuse."""

import types

import pytest

from arm_blender.errors import ArmError
from arm_blender.knobs.finishes import PRESETS, Finish, finish_of, name_of
from arm_blender.structures import MaterialMaps, RelightableAsset

bpy = pytest.importorskip("bpy")
from mathutils import Matrix, Vector  # noqa: E402

from arm_blender.blender.asset.finish_nodes import finishes  # noqa: E402
from arm_blender.blender.asset.object_asset import asset_from_object  # noqa: E402
from arm_blender.blender.asset.scene import build_object  # noqa: E402
from arm_blender.blender.materials import panel, pick_operator  # noqa: E402
from arm_blender.blender.materials.presets import items  # noqa: E402
from arm_blender.blender.materials.ray import region_under  # noqa: E402

pytestmark = pytest.mark.blender

UNDO = ("EXEC_DEFAULT", True)
"""Arguments of an operator that is called from Python to be undone as one that is clicked."""


def material():
    """Undo makes everything anew."""
    return bpy.data.objects["tile"].active_material


def press(operator, **given):
    bpy.context.view_layer.objects.active = bpy.data.objects["tile"]
    assert operator(*UNDO, **given) == {"FINISHED"}


def test_a_finish_is_one_step_and_undone(shown):
    bpy.ops.ed.undo_push(message="made")
    press(bpy.ops.arm.choose_region, number=2)
    press(bpy.ops.arm.set_finish, finish="chrome")
    assert finishes(material()) == {2: PRESETS["chrome"]}
    bpy.ops.ed.undo()
    assert finishes(material()) == {} and material().arm_region == 2 and not bpy.data.node_groups
    bpy.ops.ed.redo()
    assert finishes(material()) == {2: PRESETS["chrome"]}
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    assert material().arm_region == 1


def test_a_slider_sets_its_own_value_and_is_undone(shown, maps):
    left = maps.roughness[:, 4:, :8].mean()
    assert material().arm_region_roughness == pytest.approx(float(left), abs=6e-3), "the predicted average, first"
    metallic = material().arm_region_metallic
    bpy.ops.ed.undo_push(message="made")
    material().arm_region_roughness = 0.25
    bpy.ops.ed.undo_push(message="slid")
    (found,) = finishes(material()).values()
    assert found.roughness == 0.25 and found.metallic == pytest.approx(metallic, abs=1e-3)
    assert material().arm_region_roughness == 0.25
    bpy.ops.ed.undo()
    assert finishes(material()) == {}


def test_a_slider_after_a_finish_keeps_the_rest_of_it(shown):
    press(bpy.ops.arm.set_finish, finish="gold")
    material().arm_region_roughness = 0.75
    assert finishes(material()) == {1: Finish(0.75, 1.0, PRESETS["gold"].f0)}


@pytest.mark.parametrize("word", ["gold/0.3/1", "brushed-steel/0.35/0.5", "0.3/1", "chrome"])
def test_whatever_is_set_has_words_that_say_it_again(word):
    assert name_of(finish_of(word)) == word
    assert finish_of("gold/0.3") == Finish(0.3, 1.0, PRESETS["gold"].f0)
    for wrong in ("gold/2", "gold/0.1/0.2/0.3", "0.3", "tin/0.3", "gold/", "nan/1"):
        with pytest.raises(ArmError, match="is no finish"):
            finish_of(wrong)


def test_reset_of_one_and_of_all_are_undone(shown):
    bpy.ops.ed.undo_push(message="made")
    for number in (1, 2):
        press(bpy.ops.arm.choose_region, number=number)
        press(bpy.ops.arm.set_finish, finish="rubber")
    press(bpy.ops.arm.reset_finish)
    assert list(finishes(material())) == [1]
    bpy.ops.ed.undo()
    assert list(finishes(material())) == [1, 2]
    press(bpy.ops.arm.reset_finish, number=1)
    assert list(finishes(material())) == [2]
    bpy.ops.ed.undo()
    press(bpy.ops.arm.reset_finishes)
    assert finishes(material()) == {}
    bpy.ops.ed.undo()
    assert list(finishes(material())) == [1, 2]
    press(bpy.ops.arm.reset_finishes)
    assert bpy.ops.arm.reset_finish() == {"CANCELLED"}, "nothing is set"


@pytest.mark.parametrize("name", [name for name, _, _ in items()])
def test_every_finish_is_known_again(shown, name):
    press(bpy.ops.arm.set_finish, finish=name)
    assert finishes(material()) == {1: PRESETS[name]}
    assert asset_from_object(shown).maps.regions.finishes == {1: PRESETS[name]}


def test_what_is_shown_follows(shown):
    material().arm_view = "roughness"
    press(bpy.ops.arm.set_finish, finish="rubber")
    emission = material().node_tree.nodes["ARM map view"]
    assert emission.inputs["Color"].links[0].from_node.name == "ARM Finish"
    press(bpy.ops.arm.reset_finishes)
    assert emission.inputs["Color"].links[0].from_node.name == "Roughness"


def test_an_object_without_regions_is_told_of_it_and_nothing_is_wrong(shown, maps, tile):
    old = MaterialMaps(maps.albedo, maps.baked, maps.roughness, maps.metallic)
    made = build_object(RelightableAsset("old", tile.mesh, old), {})
    assert "arm_regions" not in made.active_material
    assert " ".join(drawn(made)) == "This object has no regions; Regenerate Appearance finds them"
    for operator in (bpy.ops.arm.set_finish, bpy.ops.arm.pick_region, bpy.ops.arm.reset_finishes):
        assert not operator.poll()
    assert made.active_material.arm_region_roughness == 0.0
    made.active_material.arm_region_roughness = 0.5
    assert "ARM Finish" not in made.active_material.node_tree.nodes
    made.active_material.arm_view = "regions"


def drawn(shown) -> list[str]:
    """The labels and the operators' texts of the panel."""
    said = []

    class Layout:
        def __getattr__(self, name):
            def call(*words, **more):
                said.extend(
                    [more["text"]] if name in ("label", "operator", "operator_menu_enum") and "text" in more else []
                )
                return Layout()

            return call

    context = types.SimpleNamespace(
        object=shown,
        preferences=types.SimpleNamespace(system=types.SimpleNamespace(ui_scale=1.0)),  # 0 without a window.
        region=types.SimpleNamespace(width=280),
    )
    panel.ARM_PT_materials.draw(types.SimpleNamespace(layout=Layout()), context)
    return said


def test_the_rows_say_number_share_and_finish(shown):
    press(bpy.ops.arm.choose_region, number=2)
    press(bpy.ops.arm.set_finish, finish="brushed-steel")
    rows = drawn(shown)
    assert rows[0] == "1   50 %   Predicted" and rows[2] == "2   50 %   Brushed Steel"


def test_beside_a_user_s_own_object_the_panel_tells_what_to_do(shown):
    bpy.ops.mesh.primitive_cube_add()
    for other in (bpy.context.object, None):
        assert " ".join(drawn(other)) == "Generate an object, or select one, to set what its parts are made of"
    assert not bpy.ops.arm.set_finish.poll()


def under(shown, x: float, y: float) -> int | None:
    """The region below a point of the square's own plane, looked at from its upper side, slightly aslant."""
    bpy.context.view_layer.update()
    matrix = shown.matrix_world
    towards = Vector((0.1, 0.1, -1.0))
    start = Vector((x, y, 0.0)) - 2.0 * towards
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return region_under(shown, depsgraph, matrix @ start, matrix.to_3x3() @ towards)


@pytest.mark.parametrize("moved", ["as made", "elsewhere", "subdivided"])
def test_a_ray_finds_the_region_that_it_meets(shown, moved):
    if moved == "elsewhere":
        shown.matrix_world = Matrix.Translation((3.0, 1.0, 2.0)) @ Matrix.Rotation(1.0, 4, "X") @ Matrix.Scale(2.5, 4)
    if moved == "subdivided":
        shown.modifiers.new("", "SUBSURF").subdivision_type = "SIMPLE"
    assert [under(shown, *place) for place in ((-0.9, -0.9), (-0.05, 0.4), (0.05, -0.4), (0.9, 0.4))] == [1, 1, 2, 2]
    assert under(shown, 0.5, 0.9) == 0
    assert under(shown, 1.5, 0.0) is None


def click(x: int, y: int):
    """A press of the left button at a pixel of the only window."""
    return types.SimpleNamespace(type="LEFTMOUSE", value="PRESS", mouse_x=x, mouse_y=y)


def picking(shown, monkeypatch):
    """A running *Pick on Object* whose viewport looks down on the square: 100 pixels to a side; and what it says."""
    said = []
    nothing = types.SimpleNamespace(windows=[])
    context = types.SimpleNamespace(
        window=types.SimpleNamespace(cursor_modal_restore=lambda: said.append("restored")),
        workspace=types.SimpleNamespace(status_text_set=said.append),
        window_manager=nothing,
        evaluated_depsgraph_get=bpy.context.evaluated_depsgraph_get,
    )
    monkeypatch.setattr(pick_operator, "viewport_under", lambda window, x, y: (None, None) if x < 200 else None)
    down = Vector((0.0, 0.0, -1.0))
    from_above = lambda region, view, x, y: (Vector((x / 50.0 - 1.0, y / 50.0 - 1.0, 5.0)), down)  # noqa: E731
    monkeypatch.setattr(pick_operator, "ray_through", from_above)
    operator = types.SimpleNamespace(_name=shown.name)
    operator.cancel = lambda context: pick_operator.ARM_OT_pick_region.cancel(operator, context)
    return lambda event: pick_operator.ARM_OT_pick_region.modal(operator, context, event), said


def test_a_click_chooses_and_a_miss_asks_again(shown, monkeypatch):
    step, said = picking(shown, monkeypatch)
    assert step(types.SimpleNamespace(type="MIDDLEMOUSE", value="PRESS")) == {"PASS_THROUGH"}
    assert step(types.SimpleNamespace(type="MOUSEMOVE", value="NOTHING")) == {"RUNNING_MODAL"}
    assert step(click(150, 50)) == {"RUNNING_MODAL"} and "missed tile" in said[-1]
    assert step(click(75, 95)) == {"RUNNING_MODAL"} and "there is no region" in said[-1]
    assert step(click(75, 50)) == {"FINISHED"} and said[-2:] == ["restored", None]
    assert material().arm_region == 2


def test_esc_and_a_click_elsewhere_leave(shown, monkeypatch):
    step, said = picking(shown, monkeypatch)
    assert step(types.SimpleNamespace(type="ESC", value="PRESS")) == {"CANCELLED"}
    assert said == ["restored", None]
    assert step(click(300, 50)) == {"CANCELLED", "PASS_THROUGH"}
    assert material().arm_region == 1
