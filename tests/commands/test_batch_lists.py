"""Many items: what a list may be, and what an item may say for itself."""

import json
import os
import sys

import pytest
import trimesh

from arm_blender.commands import batch
from arm_blender.errors import InputImageError
from arm_blender.export import is_whole

from ..pictures import a_picture
from .command_line import lines_of, only_line, run


@pytest.mark.parametrize("kind", ["txt", "csv", "json", "folder"])
def test_batch_reads_every_kind_of_list(pipeline, tmp_path, capsys, kind):
    items = tmp_path / "items"
    items.mkdir()
    a_picture(items / "a.png")
    a_picture(items / "b.png")
    path = tmp_path / f"list.{kind}"
    if kind == "txt":
        path.write_text("# two\nitems/a.png\n\nitems/b.png\n")
    elif kind == "csv":
        path.write_text("views,name,seed\nitems/a.png,,5\nitems/b.png,,\n")
    elif kind == "json":
        path.write_text(json.dumps(["items/a.png", {"views": "items/b.png", "seed": 4, "view_weights": [2]}]))
    assert run("batch", items if kind == "folder" else path, "--output", tmp_path / "out") == 0
    lines = lines_of(capsys.readouterr().out)
    assert {name: line["status"] for name, line in lines.items()} == {"a": "done", "b": "done"}
    assert is_whole(tmp_path / "out" / "a") and is_whole(tmp_path / "out" / "b")
    assert [settings.seed for _, settings in pipeline] == {"csv": [5, 0], "json": [0, 4]}.get(kind, [0, 0])


def test_results_inside_the_folder_of_the_items_are_no_items(pipeline, tmp_path, capsys):
    items = tmp_path / "items"
    items.mkdir()
    a_picture(items / "a.png")
    for _ in range(2):
        assert run("batch", items, "--output", items / "runs" / "one", "--resume") == 0
    assert list(lines_of(capsys.readouterr().out)) == ["a"]
    assert run("batch", items, "--output", items) == 2
    assert "--output" in only_line(capsys.readouterr().err)


def test_what_is_wrong_for_all_items_is_said_once_before_any(pipeline, tmp_path, capsys):
    a_picture(tmp_path / "a.png")
    (tmp_path / "list.txt").write_text("a.png\na.png\n")
    for words in (["--texture-size", "300"], ["--fovy", "200"]):
        assert run("batch", tmp_path / "list.txt", "--output", tmp_path / "out", *words) == 2
        assert words[0] in only_line(capsys.readouterr().err) and pipeline == []


def test_items_of_one_name_do_not_overwrite_each_other(pipeline, tmp_path, capsys):
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
        a_picture(tmp_path / folder / "cup.png")
    (tmp_path / "list.txt").write_text("x/cup.png\ny/cup.png\n")
    assert run("batch", tmp_path / "list.txt", "--output", tmp_path / "out") == 0
    assert sorted(lines_of(capsys.readouterr().out)) == ["cup", "cup-2"]


def test_a_name_that_is_too_long_for_files_is_cut_and_the_others_get_their_turn(pipeline, tmp_path, capsys):
    a_picture(tmp_path / "a.png")
    rows = [{"views": "a.png", "name": "\u00e9" * 300}, {"views": "a.png", "name": "x" * 300}, {"views": "a.png"}]
    (tmp_path / "list.json").write_text(json.dumps([*rows, rows[1]]))
    assert run("batch", tmp_path / "list.json", "--output", tmp_path / "out") == 0
    found = lines_of(capsys.readouterr().out)
    assert list(found) == ["\u00e9" * 95, "x" * 190, "a", "x" * 190 + "-2"]


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("list.json", '[{"views": "a.png", "name": "a\\u0000b"}]', "plain file name"),
        ("list.json", "{}", "list.json: not a JSON list"),
        ("list.json", "[", "list.json"),
        ("list.json", '[{"name": "a"}]', "item 1: no views"),
        ("list.csv", "views,colour\na.png,red\n", "colour"),
        ("list.csv", "views,seed\na.png,red\n", "seed"),
        ("list.csv", "views,name\na.png,../up\n", "plain file name"),
        ("list.csv", "views\n" + "a" * 200_000 + "\n", "list.csv: not a readable list"),
        ("list.csv", "views\n" + "a" * 5_000 + "\n", "item 1: views is"),
        ("list.json", '["/"]', "item 1: name is"),
        ("list.json", "[" * 100_000, "list.json: not a readable list"),
        ("list.txt", "# nothing\n", "no items"),
    ],
)
def test_a_bad_list_is_one_line(pipeline, tmp_path, capsys, name, text, word):
    (tmp_path / name).write_text(text)
    assert run("batch", tmp_path / name, "--output", tmp_path / "out") == 1
    assert word in only_line(capsys.readouterr().err)


def test_an_item_says_for_itself_what_differs(pipeline, pictures, tmp_path, capsys):
    (tmp_path / "list.csv").write_text(
        "views,quality,seed,faces,texture_size,grid,place\n"
        "a.png,final,7,500,512,48,ground\n"
        "b.png,,,,,,\n"
        "c.png,best,,,,,\n"
    )
    assert run("batch", tmp_path / "list.csv", "--output", tmp_path / "out", "--quality", "draft") == 1
    lines = lines_of(capsys.readouterr().out)
    (_, own), (_, common) = pipeline
    assert (own.quality, own.seed, own.faces, own.texture_size, own.grid) == ("final", 7, 500, 512, 48)
    assert (common.quality, common.seed, common.faces) == ("draft", 0, None)
    assert lines["a"]["seed"] == 7 and "--quality best" in lines["c"]["error"]
    feet = {name: trimesh.load(tmp_path / "out" / name / f"{name}.glb").bounds[0, 1] for name in "ab"}
    assert feet == pytest.approx({"a": 0.0, "b": -0.5}, abs=1e-6)


def test_help_names_every_option_of_an_item(capsys):
    assert run("batch", "--help") == 0
    said = capsys.readouterr().out
    assert all(column in said for column in batch._COLUMNS)


@pytest.mark.parametrize("row", ["\ud800", {"views": "cup.png", "name": "\ud800"}, {"views": "cup.png", "name": "\0"}])
def test_half_a_character_is_no_name(tmp_path, row):
    a_picture(tmp_path / "cup.png")
    (tmp_path / "list.json").write_text(json.dumps(["cup.png", row]))
    with pytest.raises(InputImageError, match="item 2") as caught:
        batch.read_items(tmp_path / "list.json", tmp_path / "out")
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(sys.platform != "linux", reason="names are Unicode elsewhere")
def test_a_name_that_is_no_utf_8_still_gets_a_folder_of_its_own(tmp_path):
    (tmp_path / "items").mkdir()
    for name in (b"\xff.png", b"a\xff.png"):
        (tmp_path / "items" / os.fsdecode(name)).touch()
    assert {item.name for item in batch.read_items(tmp_path / "items", tmp_path / "out")} == {"_", "a_"}
