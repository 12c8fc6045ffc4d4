"""One result: whole files, words that reach the settings, progress. The networks are played by a stand-in."""

import json

import numpy as np
import pytest
import torch
import trimesh

from arm_blender import pipeline as pipeline_of_stages
from arm_blender.export.obj import write_obj
from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh

from ..colored_box import box_mesh, cameras, pictures, write_views
from ..pictures import a_picture
from .command_line import ROOT, lines_of, only_line, run


def write_box(path):
    """The coloured box as an OBJ, Z up."""
    mesh = box_mesh()
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces.tolist()]
    path.write_text("\n".join(lines))
    return path


def test_generate_writes_a_whole_asset(pipeline, picture, tmp_path, capsys):
    assert run("generate", picture, "--output", tmp_path / "out") == 0
    files = sorted(str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.*"))
    textures = [f"textures/{name}.png" for name in ("albedo", "baked", "metallic", "roughness")]
    assert files == ["cup.glb", "report.json", *textures]
    captured = capsys.readouterr()
    assert "report.json" in captured.out and "shape" not in captured.err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["faces"] == 12 and {"start", "views", "files"} <= report["seconds"].keys()
    assert [note["what"] for note in report["left_out"]] == ["cup.blend"]


@pytest.mark.blender
def test_the_blend_is_written_where_bpy_is(pipeline, picture, tmp_path):
    assert run("generate", picture, "--output", tmp_path / "out") == 0
    assert (tmp_path / "out" / "cup.blend").stat().st_size > 0
    assert json.loads((tmp_path / "out" / "report.json").read_text())["left_out"] == []


def test_what_is_read_is_not_written_over(pipeline, picture, tmp_path, capsys):
    """Neither the mesh, nor the picture, whatever way its path takes."""
    out = tmp_path / "out"
    (out / "textures").mkdir(parents=True)
    trimesh.creation.box().export(out / "cup.glb")
    a_picture(out / "textures" / "baked.png")
    before = {path: path.read_bytes() for path in out.rglob("*.*")}
    assert run("generate", picture, "--mesh", out / ".." / "out" / "cup.glb", "--output", out) == 2
    assert "cup.glb: is read" in only_line(capsys.readouterr().err)
    assert run("generate", out / "textures" / "baked.png", "--output", out) == 2
    assert {path: path.read_bytes() for path in out.rglob("*.*")} == before and pipeline == []
    assert run("generate", picture, "--mesh", out / "cup.glb", "--output", tmp_path / "other") == 0


def test_a_second_object_is_not_put_into_the_folder_of_the_first(pipeline, picture, tmp_path, capsys):
    """With USD and OBJ both would name the same textures; the first one made again replaces itself."""
    words = "--output", tmp_path / "out", "--export", "obj,usd"
    assert run("generate", picture, *words) == 0
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*.*")}
    assert run("generate", a_picture(tmp_path / "mug.png"), *words) == 1
    assert "out: holds the asset cup" in capsys.readouterr().err and len(pipeline) == 1
    assert {path: path.read_bytes() for path in (tmp_path / "out").rglob("*.*")} == before
    assert run("generate", picture, *words) == 0 and len(pipeline) == 2


@pytest.mark.parametrize("words, found", [((), "y"), (("--mesh-up", "z"), "z"), (("--mesh-up", "y"), "y")])
def test_an_obj_of_ours_is_upright_when_it_is_read_back(monkeypatch, tmp_path, capsys, words, found):
    """OBJ says no axis: with what the views show it is known, and the report says so."""
    mesh = box_mesh()
    whole = UvMesh(mesh.vertices, mesh.faces, torch.rand(len(mesh.vertices), 2), mesh.faces, 1)
    maps = MaterialMaps(torch.zeros(3, 4, 4), torch.zeros(3, 4, 4), 0.5, 0.5)
    (tmp_path / "textures").mkdir()
    write_obj(RelightableAsset("box", whole, maps), tmp_path / "box.obj")
    given = []

    def generate(views, settings, progress, report, mesh=None):
        given.append(mesh)
        return RelightableAsset(views.name, whole, maps), report

    monkeypatch.setattr(pipeline_of_stages, "generate", generate)
    words = ["--mesh", tmp_path / "box.obj", "--output", tmp_path / "out", *words]
    assert run("generate", write_views(tmp_path / "views"), *words) == 0
    corners, wanted = (
        {(round(x, 4), round(y, 4), round(z, 4)) for x, y, z in one.vertices.tolist()} for one in (given[0], mesh)
    )
    assert (corners == wanted) == (found == "y")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert any(note["what"] == "Z up in box.obj" for note in report["left_out"]) == (words[-1] not in ("y", "z"))
    assert bool(report["doubts"]) == (found == "z"), "an outline that does not fit is doubtful"


@pytest.mark.parametrize("strict, status", [((), 0), (("--strict",), 1)])
def test_what_may_be_wrong_is_a_line_each_and_with_strict_a_status(pipeline, tmp_path, capsys, strict, status):
    """Two pictures exchanged; one item of a batch, and alone."""
    images = pictures(cameras())
    images[0], images[1] = images[1], images[0]
    wrong, right = write_views(tmp_path / "wrong", images), write_views(tmp_path / "right")
    assert run("generate", wrong, "--output", tmp_path / "out", *strict) == status
    said = [line for line in capsys.readouterr().err.splitlines() if "0.png and 1.png do not fit" in line]
    assert len(said) == 1 and said[0].startswith("arm: doubtful: ")
    (tmp_path / "list.txt").write_text("wrong\nright\n")
    assert run("batch", tmp_path / "list.txt", "--output", tmp_path / "many", *strict) == status
    captured = capsys.readouterr()
    assert f"arm: doubtful: {wrong}: 0.png and 1.png" in captured.err
    lines = lines_of(captured.out)
    assert any("0.png and 1.png" in why for why in lines["wrong"]["doubts"]) and lines["wrong"]["status"] == "done"
    assert run("generate", right, "--output", tmp_path / "good", "--mesh", write_box(tmp_path / "b.obj"), *strict) == 0


def test_json_is_all_there_is_on_stdout(pipeline, picture, tmp_path, capsys):
    assert run("generate", picture, "--output", tmp_path / "out", "--json") == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["faces"] == 12 and captured.err == ""


def test_the_words_reach_the_settings(pipeline, picture, tmp_path):
    words = "--quality final --texture-size 512 --faces 777 --grid 40 --dense --seed 3 --threads 2 --time-limit 9"
    words += " --precision bfloat16 --random-weights 4"
    words += f" --weights {ROOT / 'arm_blender' / 'weights'}"
    assert run("generate", picture, "--output", tmp_path / "out", *words.split(), "--view-weights", "2.5") == 0
    views, settings = pipeline[0]
    assert views.weights.tolist() == [2.5] and settings.quality == "final"
    assert (settings.texture_size, settings.faces, settings.grid, settings.dense) == (512, 777, 40, True)
    assert (settings.seed, settings.threads, settings.time_limit) == (3, 2, 9.0)
    assert (settings.precision, settings.random_weights) == ("bfloat16", 4)
    assert settings.weights_folder == ROOT / "arm_blender" / "weights"


def test_the_ground_is_under_the_object(pipeline, picture, tmp_path):
    assert run("generate", picture, "--output", tmp_path / "out", "--place", "ground") == 0
    found = trimesh.load(tmp_path / "out" / "cup.glb").geometry["cup"]
    np.testing.assert_allclose(found.bounds, [[-0.5, 0.0, -0.5], [0.5, 1.0, 0.5]], atol=1e-6)  # glTF: Y is up


def test_progress_is_shown_on_demand(pipeline, picture, tmp_path, capsys):
    assert run("generate", picture, "--output", tmp_path / "out", "--progress", "always") == 0
    messages = [line.partition("% ")[2].partition(", about ")[0] for line in capsys.readouterr().err.splitlines()]
    wanted = ["starting", "reading cup.png", "shaping", "writing textures", "writing cup.glb", "writing report.json"]
    assert [message for message in messages if message in wanted] == wanted
