"""One schema of what an object keeps; what earlier versions wrote is read as far as it goes."""

import json
from pathlib import Path

import pytest

from arm_blender.asset_record import SCHEMA, AssetRecord, chosen_values, read_record
from arm_blender.errors import ArmError
from arm_blender.knobs import Knobs, ViewKnobs, knobs_of

OF_THE_PANEL = {
    "views": "/pictures/cup",
    "cameras": None,
    "mesh": None,
    "weights": [1.0, 0.0, 2.5],
    "elevation_deg": 20.0,
    "fovy_deg": 40.0,
    "rig_distance": 3.5,
    "preset": "small",
    "quality": "draft",
    "texture_size": 512,
    "faces": None,
    "normal_map": True,
    "own_weights": "/mine/",
    "seed": 5,
    "report": {"faces": 576},
    "versions": {"arm": "0.9.0"},
}
"""As the panel wrote it before there was a schema; `arm_frame` lay beside it."""

OF_THE_COMMAND_LINE = {
    "preset": "paper",
    "quality": "final",
    "texture_size": None,
    "faces": 700,
    "grid": 48,
    "dense": True,
    "seed": 4,
    "device": "cuda",
    "threads": 3,
    "time_limit": 60.0,
    "precision": "float32",
    "random_weights": None,
    "blend": "robust",
    "normal_map": False,
    "weights_folder": "/trained",
}
"""As the command line wrote it: its settings, of which `blend` is gone."""


def a_record(**more) -> AssetRecord:
    chosen = chosen_values(Knobs(quality="final", seed=3, dense=True), ViewKnobs(fovy_deg=20.0, weights=(1.0, 0.5)))
    return AssetRecord(chosen, **more)


def read(kept, folder=None, frame=None) -> AssetRecord:
    return read_record("cup", json.dumps(kept), folder, frame)


def test_a_record_comes_back_as_it_was_written(tmp_path):
    whole = a_record(
        views=tmp_path / "views",
        mesh="Cube",
        frame=(2.0, 0.0, 1.0, 0.5),
        report={"faces": 3},
        shape_report={"faces": 3},
        versions={"arm": "1"},
    )
    of_cameras = a_record(cameras=("a", "b"), frame=(1.0, 0.0, 0.0, 0.0))
    for record in (whole, of_cameras):
        for folder in (None, tmp_path):
            assert read(record.as_json(folder), folder) == record
            assert record.as_json(folder)["schema"] == SCHEMA


def test_what_is_the_machines_is_not_kept():
    kept = {one.name for declared in (Knobs, ViewKnobs) for one in knobs_of(declared)} - {"device", "threads"}
    assert set(a_record().chosen) == kept


def test_paths_are_relative_and_go_along_with_their_folder(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    (first / "views").mkdir(parents=True)
    (first / "out").mkdir()
    chosen = a_record().chosen | {"weights_folder": first / "trained"}
    kept = AssetRecord(chosen, views=first / "views").as_json(first / "out")
    assert (kept["views"], kept["weights_folder"]) == ("//../views", "//../trained")
    # The object was appended to a file elsewhere: what it names is still where it was.
    assert read(kept, tmp_path).views == read(kept).views == first / "views"
    first.rename(second)
    moved = read(kept, second / "out")
    assert (moved.views, moved.chosen["weights_folder"]) == (second / "views", second / "trained")


def test_what_the_panel_wrote_before_is_read():
    found = read(OF_THE_PANEL, frame=[2.0, 1.0, 2.0, 3.0])
    assert (found.views, found.cameras, found.mesh) == (Path("/pictures/cup"), None, None)
    assert found.frame == (2.0, 1.0, 2.0, 3.0) and found.report == {"faces": 576}
    asked = {"quality": "draft", "texture_size": 512, "normal_map": True, "seed": 5, "weights": (1.0, 0.0, 2.5)}
    asked |= {"elevation_deg": 20.0, "fovy_deg": 40.0, "rig_distance": 3.5, "weights_folder": Path("/mine")}
    assert found.chosen == chosen_values(Knobs(), ViewKnobs()) | asked
    early = {name: value for name, value in OF_THE_PANEL.items() if name != "own_weights"}
    assert read(early).chosen["weights_folder"] is None
    of_cameras = read(OF_THE_PANEL | {"views": None, "cameras": ["a", "b"]})
    assert (of_cameras.views, of_cameras.cameras) == (None, ("a", "b"))


def test_what_the_command_line_wrote_before_is_read():
    found = read(OF_THE_COMMAND_LINE)
    assert (found.views, found.cameras, found.frame, found.report) == (None,) * 4
    asked = {"preset": "paper", "quality": "final", "faces": 700, "grid": 48, "dense": True, "seed": 4}
    asked |= {"precision": "float32", "weights_folder": Path("/trained")}
    assert found.chosen == chosen_values(Knobs(), ViewKnobs()) | asked


@pytest.mark.parametrize("text", ["", "[]", "3", "{", '{"views": "a"}', '{"preset": "small", "views": 3}'])
def test_what_is_none_of_ours_is_one_line(text):
    with pytest.raises(ArmError, match="^cup: carries no settings of ours; generate it anew$"):
        read_record("cup", text, None)


def test_what_a_later_version_wrote_is_refused():
    with pytest.raises(ArmError, match="^cup: was made by a later version"):
        read(a_record().as_json(None) | {"schema": SCHEMA + 1})
