"""Views are looked at before a run, keep their ticks and weights, and reach the run with them; so does an own mesh."""

import json
import time
import types

import numpy as np
import pytest
import torch

import arm_blender
from arm_blender.report import Report
from arm_blender.structures import RelightableAsset
from arm_blender.views.image_io import write_png
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.scene_frame import SceneFrame
from arm_blender.views.transforms_json import write_transforms

bpy = pytest.importorskip("bpy")
from arm_blender.blender.generate import operators  # noqa: E402
from arm_blender.blender.generate.generation import Generated  # noqa: E402
from arm_blender.blender.input import view_list  # noqa: E402

from ...pictures import SIZE, picture, six_pictures  # noqa: E402

pytestmark = pytest.mark.blender


@pytest.fixture
def panel(empty_file):
    """The scene's settings of the registered extension."""
    arm_blender.register()
    yield bpy.context.scene.arm
    arm_blender.unregister()


@pytest.fixture
def answer(monkeypatch, asset):
    """Stands in for the run: a ring, or the maps of one for an own mesh; keeps the requests."""
    requests = []

    def run(request, progress):
        requests.append(request)
        frame = SceneFrame(torch.tensor([1.0, 2.0, 3.0]), 2.0)
        maps = (
            asset.maps
            if len(requests) == 1
            else type(asset.maps)(*(1.0 - m for m in vars(asset.maps).values() if m is not None))
        )
        return Generated(RelightableAsset("ring", asset.mesh, maps), Report("small", "cpu", request.seed), frame)

    monkeypatch.setattr(operators, "generate", run)
    return requests


@pytest.fixture
def six(tmp_path):
    """A folder of the rig's six pictures, the last of which shows nothing."""
    folder = six_pictures(tmp_path / "cup")
    write_png(folder / "5.png", picture(filled=False), srgb=True)
    return folder


def thumbnail(name: str) -> np.ndarray:
    preview = view_list._previews[name]
    return np.array(preview.image_pixels_float[:]).reshape(*tuple(preview.image_size)[::-1], 4)


def test_a_look_lists_the_views_with_picture_and_foreground(panel, six):
    panel.views_path = str(six)
    assert len(panel.views) == 0, "without a window nothing is read before it is asked for"
    assert bpy.ops.arm.look() == {"FINISHED"}
    assert [(view.name, view.use, view.sees) for view in panel.views] == [(f"{i}.png", True, i < 5) for i in range(6)]
    assert panel.views_kind == "rig"
    mask = thumbnail("0 mask")
    assert mask.shape == (SIZE, SIZE, 4) and mask[..., 3].min() == 1.0
    rows, columns = np.nonzero(mask[::-1, :, 0] > 0.5)  # Blender's rows start at the bottom.
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (16, 47, 20, 43)
    shade = thumbnail("2 picture")[32, 32, :3]
    assert shade == pytest.approx([1.055 * 0.5 ** (1 / 2.4) - 0.055] * 3, abs=1 / 255)


def test_weights_of_transforms_are_where_the_list_begins(panel, six):
    rig = zero123plus_rig(size=SIZE)
    write_transforms(six / "transforms.json", ["0.png", "1.png", "2.png"], rig[:3], [0.5, 0.0, 1.0])
    panel.views_path = str(six)
    bpy.ops.arm.look()
    assert panel.views_kind == "posed"
    assert [(view.use, view.weight) for view in panel.views] == [(True, 0.5), (False, 1.0), (True, 1.0)]


def test_ticks_and_weights_reach_the_run_and_stay_when_the_views_are_read_again(panel, six, answer):
    panel.views_path = str(six)
    bpy.ops.arm.look()
    panel.views[1].use, panel.views[3].weight = False, 2.5
    bpy.ops.arm.look()
    bpy.ops.arm.generate()
    assert answer[0].weights == (1.0, 0.0, 1.0, 2.5, 1.0, 1.0)


def test_a_folder_may_end_in_a_slash(panel, six, answer):
    panel.views_path = f"{six}/"
    bpy.ops.arm.look()
    panel.views[1].use = False
    bpy.ops.arm.generate()
    assert answer[0].weights == (1.0, 0.0, 1.0, 1.0, 1.0, 1.0)


def test_the_ticks_of_other_views_do_not_count(panel, six, answer, tmp_path):
    panel.views_path = str(six)
    bpy.ops.arm.look()
    panel.views[1].use = False
    bpy.ops.arm.generate(filepath=str(tmp_path))
    assert answer[0].weights is None


@pytest.mark.parametrize("made", ["gone.png", "noise.png"])
def test_pictures_that_do_not_do_are_said_before_a_run(panel, tmp_path, made):
    if made == "noise.png":
        write_png(tmp_path / made, torch.rand(3, SIZE, SIZE, generator=torch.Generator().manual_seed(0)), srgb=True)
    panel.views_path = str(tmp_path / made)
    with pytest.raises(RuntimeError, match=made):
        bpy.ops.arm.look()
    assert made in bpy.context.window_manager.arm.views_error
    assert len(panel.views) == 0


def test_cameras_of_the_rig_come_back_as_its_views(panel, six, answer):
    panel.views_path, panel.rig_distance = str(six), 3.5
    bpy.ops.arm.look()
    assert bpy.ops.arm.add_cameras() == {"FINISHED"}
    panel.source = "CAMERAS"
    bpy.ops.arm.look()
    panel.views[0].use = False
    bpy.ops.arm.generate()
    (request,) = answer
    assert [one.name for one in request.views] == [f"{index}.png" for index in range(6)]
    assert request.weights == (0.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    for one, camera in zip(request.views, zero123plus_rig(3.5, 30.0, SIZE), strict=True):
        assert np.allclose(one.c2w, camera.c2w.numpy(), atol=1e-5) and np.allclose(one.K, camera.K.numpy(), atol=1e-3)


def test_without_pictures_the_rig_is_put_into_the_scene(panel):
    assert bpy.ops.arm.add_cameras() == {"FINISHED"}
    cameras = [item for item in bpy.data.objects if item.type == "CAMERA"]
    assert len(cameras) == 6 and all(item.location.length == pytest.approx(4.0, abs=1e-5) for item in cameras)


def test_an_own_mesh_is_handed_on_and_its_result_stays_in_its_place(panel, six, answer):
    bpy.ops.mesh.primitive_cube_add(location=(4.0, 0.0, 0.0))
    cube = bpy.context.object
    panel.views_path, panel.shape, panel.as_asset = str(six), "MESH", True
    bpy.ops.arm.generate()
    (request,) = answer
    assert request.mesh.name == "Cube" and request.mesh.vertices[:, 0].min() == pytest.approx(3.0)
    made = bpy.context.object
    assert made != cube and tuple(made.location) == tuple(cube.location), "the origin is that of the user's object"
    bpy.context.view_layer.update()
    ring = [made.matrix_world @ vertex.co for vertex in made.data.vertices]
    assert max(vertex.x for vertex in ring) == pytest.approx(1.0, abs=1e-5), "and the surface is where the run put it"
    assert json.loads(made["arm_settings"])["frame"] == pytest.approx(
        [2.0, 9.0, 2.0, 3.0]
    )  # The stub's, around (4, 0, 0).
    assert made.asset_data is not None and "relightable" in made.asset_data.tags
    pixels = np.array(made.preview.image_pixels_float[:]).reshape(-1, 4)
    assert 0.1 < (pixels[:, 3] > 0.5).mean() < 0.9 and pixels[pixels[:, 3] > 0.5, :3].std() > 0.05


def test_regenerating_asks_for_the_appearance_alone_and_changes_nothing_else(panel, six, answer, asset):
    panel.views_path, panel.quality, panel.seed, panel.own_weights = str(six), "draft", 5, f"{six.parent}/"
    bpy.ops.arm.look()
    bpy.ops.arm.generate()
    made = bpy.context.object
    place, mesh = made.matrix_world.copy(), made.data
    panel.quality, panel.seed, panel.views[4].use, panel.own_weights = "final", 6, False, ""
    assert bpy.ops.arm.regenerate() == {"FINISHED"}
    again = answer[1]
    assert (again.quality, again.seed) == ("draft", 5), "what the object was made with"
    assert answer[0].weights_folder == again.weights_folder == six.parent
    assert again.weights == (1.0, 1.0, 1.0, 1.0, 0.0, 1.0), "and what the panel says of its views"
    assert again.mesh_in_place
    # The stub's frame says that cameras see the ring twice as large around (1, 2, 3); the panel made it 1 m high.
    expected = 2.0 * asset.mesh.vertices.numpy() + np.array([1.0, 2.0, 3.0])
    assert np.sort(again.mesh.vertices, axis=0) == pytest.approx(np.sort(expected, axis=0), abs=1e-4)
    assert (bpy.context.object, made.data, made.matrix_world) == (made, mesh, place)
    assert len(bpy.data.objects) == 1 and len(bpy.data.materials) == 1
    assert "shape_report" in json.loads(made["arm_settings"])


def test_an_objects_settings_come_back_into_the_panel(panel, six, answer):
    panel.views_path, panel.quality, panel.texture_size = str(six), "draft", "512"
    panel.own_weights = str(six.parent)
    bpy.ops.arm.look()
    panel.views[2].use, panel.views[0].weight = False, 3.0
    bpy.ops.arm.generate()
    panel.views_path, panel.quality, panel.texture_size, panel.own_weights = "", "final", "AUTO", ""
    panel.views.clear()
    assert bpy.ops.arm.recall() == {"FINISHED"}
    assert (panel.views_path, panel.quality, panel.texture_size) == (str(six), "draft", "512")
    assert panel.own_weights == str(six.parent)
    bpy.ops.arm.look()
    assert [view.use for view in panel.views] == [True, True, False, True, True, True]
    assert panel.views[0].weight == 3.0


def test_an_object_from_before_there_were_own_weights_is_made_anew_without(panel, six, answer):
    panel.views_path = str(six)
    bpy.ops.arm.generate()
    made = bpy.context.object
    kept = json.loads(made["arm_settings"])
    made["arm_settings"] = json.dumps({name: value for name, value in kept.items() if name != "weights_folder"})
    assert bpy.ops.arm.regenerate() == {"FINISHED"} and answer[1].weights_folder is None
    panel.own_weights = str(six)
    assert bpy.ops.arm.recall() == {"FINISHED"} and panel.own_weights == ""


@pytest.mark.parametrize("settings", ["", "[]", '{"views": "a"}'])
def test_settings_that_cannot_be_read_are_one_line(panel, settings):
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object["arm_settings"], bpy.context.object["arm_frame"] = settings, [1.0, 0.0, 0.0, 0.0]
    for operator in (bpy.ops.arm.recall, bpy.ops.arm.regenerate):
        with pytest.raises(RuntimeError, match="Cube: .*generate it anew"):
            operator()


class Timers:
    """Blender's timers, which never fire without a window."""

    def __init__(self):
        self.functions = []

    def register(self, function, first_interval):
        self.functions.append(function)

    def unregister(self, function):
        self.functions.remove(function)

    def is_registered(self, function) -> bool:
        return function in self.functions

    def run(self):
        deadline = time.monotonic() + 20.0
        while self.functions:
            assert time.monotonic() < deadline
            self.functions = [function for function in self.functions if function() is not None]
            time.sleep(0.01)


@pytest.fixture
def timers(monkeypatch):
    """As behind a window, where choosing views has them read."""
    app = types.SimpleNamespace(background=False, timers=Timers())
    monkeypatch.setattr(view_list, "bpy", types.SimpleNamespace(app=app, utils=bpy.utils, context=bpy.context))
    return app.timers


def test_choosing_views_has_them_read_on_a_thread(panel, six, timers):
    panel.views_path = str(six)
    assert view_list.is_looking() and len(panel.views) == 0
    timers.run()
    assert not view_list.is_looking() and len(panel.views) == 6


def test_a_second_choice_replaces_the_first_before_it_is_read(panel, six, timers, tmp_path):
    panel.views_path = str(tmp_path / "gone.png")
    panel.views_path = str(six)
    timers.run()
    assert bpy.context.window_manager.arm.views_error == "" and len(panel.views) == 6
    panel.views_path = str(tmp_path / "gone.png")
    timers.run()
    assert "gone.png: no such file" in bpy.context.window_manager.arm.views_error
    panel.views_path = ""
    assert bpy.context.window_manager.arm.views_error == "" and not timers.functions


def test_disabling_the_extension_ends_a_look(panel, six, timers):
    panel.views_path = str(six)
    job = view_list._job
    view_list.forget()
    assert job.finished and not timers.functions and not view_list.is_looking()
