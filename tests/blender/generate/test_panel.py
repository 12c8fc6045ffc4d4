"""The panel shows what the chosen input needs and nothing else; the layout is a stand-in that remembers."""

import json
import types
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import arm_blender
from arm_blender.machine import libraries
from arm_blender.quality_levels import measured_levels
from arm_blender.views import foreground
from arm_blender.views.image_io import write_png

bpy = pytest.importorskip("bpy")
from arm_blender.blender.generate import matting_operator, notices, result_panel  # noqa: E402
from arm_blender.blender.generate import panel as panels  # noqa: E402
from arm_blender.blender.input import request, view_list  # noqa: E402
from arm_blender.blender.input.looking import Look  # noqa: E402
from arm_blender.blender.setup import background, runtime  # noqa: E402

pytestmark = pytest.mark.blender


class Layout:
    """Remembers properties, operators and labels, of all its parts together."""

    def __init__(self, seen: dict[str, list] | None = None):
        self.__dict__["seen"] = seen if seen is not None else {"prop": [], "operator": [], "label": [], "icon": []}

    def __setattr__(self, name, value): ...

    def _part(self, **options):
        return Layout(self.seen)

    row = column = box = split = grid_flow = _part

    def prop(self, data, name, **options):
        self.seen["prop"].append(name)

    def operator(self, name, **options):
        self.seen["operator"].append(name)
        return types.SimpleNamespace()

    def progress(self, **options): ...

    def label(self, text="", **options):
        self.seen["label"].append(text)

    def template_icon(self, icon_value, scale):
        self.seen["icon"].append(scale)

    def template_list(self, kind, name, data, listed, *rest, **options):
        self.seen["prop"].append(listed)

    def prop_enum(self, data, name, value):
        self.seen["prop"].append(value)

    def separator(self): ...


@pytest.fixture
def settings(empty_file):
    arm_blender.register()
    yield bpy.context.scene.arm
    arm_blender.unregister()


def drawn(panel=None, shading="MATERIAL") -> dict[str, list]:
    context = types.SimpleNamespace(
        scene=bpy.context.scene,
        window_manager=bpy.context.window_manager,
        object=bpy.context.object,
        mode=bpy.context.mode,
        space_data=types.SimpleNamespace(
            local_view=None, shading=types.SimpleNamespace(type=shading, color_type="MATERIAL")
        ),
        preferences=types.SimpleNamespace(system=types.SimpleNamespace(ui_scale=1.0)),  # 0 without a window.
        region=types.SimpleNamespace(width=280),
    )
    layout = Layout()
    (panel or panels.ARM_PT_generate).draw(types.SimpleNamespace(layout=layout), context)
    return layout.seen


def listed(settings, kind: str, names: list[str]) -> None:
    settings.views_path = "//cup"
    settings.views_of, settings.views_kind = request.path_key("//cup"), kind
    for name in names:
        settings.views.add().name = name


@pytest.mark.parametrize("absent", [[], ["torch"]])
def test_the_preferences_are_offered_only_where_something_is_missing(settings, monkeypatch, absent):
    monkeypatch.setattr(libraries, "missing", lambda asked: absent)
    seen = drawn()
    assert ("preferences.addon_show" in seen["operator"]) == bool(absent)
    assert ("PyTorch is missing" in " ".join(seen["label"])) == bool(absent)


@pytest.mark.parametrize(
    ("kind", "names", "shown", "hidden"),
    [
        ("picture", ["cup.png"], {"elevation", "fovy", "multiview_model"}, {"rig_distance", "use", "weight"}),
        ("rig", list("012345"), {"rig_distance", "fovy", "use", "weight"}, {"elevation", "multiview_model"}),
        ("posed", list("0123"), {"use", "weight"}, {"elevation", "fovy", "rig_distance"}),
        ("", [], set(), {"elevation", "fovy", "rig_distance", "use", "weight"}),
    ],
)
def test_only_what_the_views_need_is_shown(settings, kind, names, shown, hidden):
    listed(settings, kind, names)
    seen = drawn()
    assert shown <= set(seen["prop"]) and not hidden & set(seen["prop"])
    assert seen["prop"].count("use") == (len(names) if len(names) > 1 else 0)
    assert len(seen["icon"]) == 2 * len(names), "each view has its picture and its foreground"


def test_who_has_chosen_nothing_is_told_what_to_do_and_given_the_example(settings):
    seen = drawn()
    assert "arm.load_example" in seen["operator"] and "try the example" in " ".join(seen["label"])
    settings.views_path = "//cup"
    assert "arm.load_example" not in drawn()["operator"]
    settings.source = "CAMERAS"
    assert "arm.load_example" in drawn()["operator"]
    bpy.data.cameras.new("front").background_images.new()
    assert "arm.load_example" not in drawn()["operator"]


def test_a_list_that_was_saved_asks_for_a_look_at_its_pictures(settings, monkeypatch):
    listed(settings, "posed", ["a.png", "b.png"])
    assert "Press Refresh" in " ".join(drawn()["label"])
    monkeypatch.setattr(view_list, "found", lambda context: Look("posed", (), ()))
    assert "Press Refresh" not in " ".join(drawn()["label"])


def test_the_list_of_other_views_is_not_shown(settings):
    listed(settings, "rig", list("012345"))
    settings.views_path = "//other"
    assert not {"use", "weight", "rig_distance"} & set(drawn()["prop"])


def test_a_folder_of_own_weights_is_asked_for_apart_and_named_beside_its_result(settings, asset):
    from arm_blender.blender.asset.scene import build_object
    from arm_blender.blender.input.generation_request import GenerationRequest

    assert "own_weights" not in drawn()["prop"]
    assert drawn(panels.ARM_PT_advanced)["prop"] == ["preset", "own_weights", "finish", "seed"]
    for folder, named in ((None, False), (Path("gone/of mine/"), True)):
        build_object(asset, GenerationRequest(Path("cup"), weights_folder=folder).record(None).as_json(None))
        assert ("Weights of of mine" in drawn(result_panel.ARM_PT_result)["label"]) is named


def test_a_view_that_shows_nothing_has_no_weight(settings):
    listed(settings, "posed", ["a.png", "b.png"])
    settings.views[1].sees = False
    seen = drawn()
    assert seen["prop"].count("weight") == 1 and "b.png: shows nothing" in seen["label"]


def test_photographs_are_told_of_and_the_mask_of_the_chosen_one_is_offered(settings, monkeypatch):
    listed(settings, "photographs", ["a.jpg", "b.jpg"])
    assert "photographs" not in drawn()["prop"]
    for name, view, whole in (("a.jpg", "a.png", "Mask by small network"), ("b.jpg", "", "No view: blurred")):
        row = settings.photographs.add()
        row.name, row.view, row.picture, row.whole = name, view, view, whole
    monkeypatch.setattr(view_list, "found", lambda context: Look("photographs", (), (), Path("cup-views")))
    seen = drawn()
    assert "photographs" in seen["prop"] and "1 of 2 photographs are views" in seen["label"]
    assert "a.jpg: Mask by small network" in seen["label"] and "arm.edit_mask" in seen["operator"]
    settings.photograph = 1
    seen = drawn()
    assert "b.jpg: No view: blurred" in seen["label"] and "arm.edit_mask" not in seen["operator"]


def test_an_own_mesh_needs_no_faces_and_no_place(settings):
    assert {"faces", "placement", "size"} <= set(drawn()["prop"])
    settings.placement = "cameras"
    assert "size" not in drawn()["prop"]
    settings.shape = "MESH"
    seen = drawn()
    assert not {"faces", "placement", "size"} & set(seen["prop"]) and "Select a mesh" in seen["label"]
    bpy.ops.mesh.primitive_cube_add()
    assert "Cube, its UVs" in drawn()["label"]
    bpy.ops.object.mode_set(mode="EDIT")
    assert "Cube: go back to Object Mode" in drawn()["label"]


@pytest.mark.parametrize("quality", ["draft", "balanced", "final"])
def test_a_quality_says_in_an_artist_s_words_what_was_measured(settings, quality):
    settings.quality = quality
    level = measured_levels()[quality]
    color = 100.0 * 10.0 ** (-level.psnr / 20.0)
    said = " ".join(drawn()["label"])
    assert f"About {sum(level.seconds.values()):.0f} seconds on two processor cores" in said
    assert f"shape off by {100.0 * level.chamfer / 4.0:.0f}% of its size, colors by {color:.0f}%" in said
    settings.shape = "MESH"
    said = " ".join(drawn()["label"])
    assert f"About {sum(level.seconds.values()) - level.seconds['shape']:.0f} seconds" in said
    assert f"colors off by {color:.0f}%" in said and "shape off" not in said


def test_networks_that_were_not_measured_are_named_and_nothing_is_promised(settings):
    settings.preset = "paper"
    said = " ".join(drawn()["label"])
    assert "Networks: Paper, as set in Advanced" in said and "seconds" not in said


def test_a_long_error_is_shown_whole(settings):
    message = "a/long/path/to/cup.png: no foreground found; supply an image with alpha, or one on a plain background"
    bpy.context.window_manager.arm.error = message
    labels = drawn()["label"]
    assert all(len(line) < 45 for line in labels)
    assert message.replace(" ", "") in "".join(labels).replace(" ", "")


@pytest.mark.parametrize("there", [False, True])
def test_an_error_that_a_matting_model_would_mend_has_it_as_a_button(settings, monkeypatch, there):
    monkeypatch.setattr(runtime, "has_matting", lambda: there)
    state = bpy.context.window_manager.arm
    state.error = "cup.png: no foreground found (no matting model is there); or get a matting model: weights"
    assert ("arm.get_matting_model" in drawn()["operator"]) is not there
    assert "arm.edit_mask" not in drawn()["operator"], "a camera has no file to paint a mask for"
    state.error = f"{Path('cup.png').absolute()}{notices.NO_FOREGROUND} (it is foggy)"
    assert "arm.edit_mask" in drawn()["operator"]
    state.error = f"{Path('cup.png').absolute()}: not a readable picture"
    assert not {"arm.get_matting_model", "arm.edit_mask"} & set(drawn()["operator"])


def test_what_the_panel_knows_of_an_error_is_what_is_raised(settings, tmp_path, monkeypatch):
    monkeypatch.setattr(foreground, "WAYS", {})
    write_png(tmp_path / "fog.png", torch.full((3, 64, 64), 0.5), srgb=True)
    settings.views_path = str(tmp_path / "fog.png")
    with pytest.raises(RuntimeError, match=f"fog.png{notices.NO_FOREGROUND}") as raised:
        bpy.ops.arm.look()
    assert matting_operator.wants_matting(str(raised.value))


def test_what_is_being_installed_is_shown_and_can_be_stopped(settings, monkeypatch):
    monkeypatch.setattr(background, "progress", lambda: (0.5, "half of it"))
    assert "arm.cancel_setup" in drawn()["operator"]


def test_a_result_is_described_and_recalled_and_made_anew_where_its_views_are_known(settings, asset):
    from arm_blender.blender.asset.scene import build_object
    from arm_blender.blender.input.generation_request import GenerationRequest

    report = {"faces": 576, "texture_size": 16, "seconds": {"shape": 1.25, "appearance": 2.0}}
    record = replace(GenerationRequest(Path("cup"), quality="draft").record(None), report=report)
    built = build_object(asset, record.as_json(None))
    assert result_panel.ARM_PT_result.poll(bpy.context)
    seen = drawn(result_panel.ARM_PT_result)
    assert seen["prop"] == ["arm_view"] and seen["operator"] == ["arm.recall"], "without a frame none of its views"
    built["arm_settings"] = json.dumps(replace(record, frame=(1.0, 0.0, 0.0, 0.0)).as_json(None))
    seen = drawn(result_panel.ARM_PT_result)
    assert seen["operator"] == ["arm.regenerate", "arm.recall"]
    assert seen["label"] == ["Draft quality, seed 0", "576 faces, texture of 16 pixels", "Made in 0:03"]
    built["arm_settings"] = "{}"
    assert any("generate it anew" in line for line in [" ".join(drawn(result_panel.ARM_PT_result)["label"])])


def test_a_result_that_cannot_be_seen_says_why(settings, asset):
    from arm_blender.blender.asset.scene import build_object
    from arm_blender.blender.generate.hiding import hider_of

    bpy.ops.mesh.primitive_cube_add(size=4.0)
    cube = bpy.context.object
    built = build_object(asset, {})
    assert hider_of(bpy.context, built) is cube and hider_of(bpy.context, cube) is None
    state = bpy.context.window_manager.arm
    state.newest, state.hidden_by = built.name, cube.name
    seen = drawn(result_panel.ARM_PT_result)
    assert "Cube hides it" in seen["label"] and "view3d.localview" in seen["operator"]
    cube.hide_set(True)
    assert "Cube hides it" not in drawn(result_panel.ARM_PT_result)["label"] and hider_of(bpy.context, built) is None
    cube.hide_set(False)
    cube.location.x = 3.0
    assert hider_of(bpy.context, built) is None
    assert "MATERIAL" not in drawn(result_panel.ARM_PT_result)["prop"]
    assert "MATERIAL" in drawn(result_panel.ARM_PT_result, "SOLID")["prop"]
