"""The command line's contract: status, one line per error, whole results. The networks are played by a stand-in."""

import importlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from arm_blender.__main__ import INTERRUPTED, main
from arm_blender.commands import interrupts
from arm_blender.commands.progress_line import ProgressLine
from arm_blender.export import is_whole
from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh
from arm_blender.views.image_io import write_png

ROOT = Path(__file__).parents[1]
MULTIVIEW = ["--multiview", "zero123plus", "--multiview-model", "weights"]


@pytest.fixture
def pipeline(monkeypatch):
    """Stands in for the pipeline: a box for every view set; keeps what it was asked for."""
    from arm_blender import pipeline

    calls = []

    def generate(views, settings, progress, report, mesh=None):
        calls.append((views, settings))
        progress(0.5, "shaping")
        box = trimesh.creation.box()
        vertices, faces = torch.from_numpy(box.vertices.copy()).float(), torch.from_numpy(box.faces.copy()).long()
        mesh = UvMesh(vertices, faces, torch.rand(len(vertices), 2), faces, 1)
        maps = MaterialMaps(*(torch.full((channels, 4, 4), 0.5) for channels in (3, 3, 1, 1)))
        report.faces = len(faces)
        return RelightableAsset(views.name, mesh, maps), report

    monkeypatch.setattr(pipeline, "generate", generate)
    return calls


@pytest.fixture(autouse=True)
def no_blender(monkeypatch, request):
    """As where bpy is not installed, unless the test is marked `blender`."""
    if request.node.get_closest_marker("blender") is None:
        for name in ("export", "relight"):
            monkeypatch.setitem(sys.modules, f"arm_blender.blender.{name}", None)
            # An earlier test may have imported it: the package then has it as an attribute as well.
            monkeypatch.delattr(f"arm_blender.blender.{name}", raising=False)


@pytest.fixture
def picture(tmp_path) -> Path:
    return a_picture(tmp_path / "cup.png")


def a_picture(path: Path) -> Path:
    image = torch.full((4, 64, 64), 0.5)
    image[3] = 0.0
    image[3, 16:48, 20:44] = 1.0
    write_png(path, image, srgb=True)
    return path


def run(*words) -> int:
    return main([str(word) for word in words])


def only_line(text: str) -> str:
    lines = text.splitlines()
    assert len(lines) == 1, text
    return lines[0]


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


@pytest.fixture
def drawn(monkeypatch) -> list:
    """Stands in for Zero123++: six views of a block on grey; keeps how it was asked."""
    from arm_blender.views.zero123plus import provider

    calls = []

    def six_views(networks, picture, config, noise, progress):
        calls.append((config, noise.seeds))
        progress(0.5, "drawing")
        views = torch.full((6, 3, config.side, config.side), 0.5)
        views[:, 0, 80:240, 80:240] = 0.9
        return views

    for name in ("check_model", "load_networks"):
        monkeypatch.setattr(provider, name, lambda *_: None)
    monkeypatch.setattr(provider, "six_views", six_views)
    return calls


def test_the_six_views_of_a_picture_are_written_and_taken(pipeline, drawn, picture, tmp_path):
    words = "--multiview-steps 75 --multiview-guidance 3 --multiview-background white --seed 5 --threads 2"
    out = tmp_path / "out"
    assert run("generate", picture, "--output", out, *MULTIVIEW, *words.split()) == 0
    (config, seeds), (views, _) = drawn[0], pipeline[0]
    assert (config.model, config.steps, config.guidance, config.background) == (Path("weights"), 75, 3.0, "white")
    assert (config.device, config.threads, seeds) == ("cpu", 2, (5,) * 6)
    assert views.name == "cup" and views.images.shape == (6, 4, 320, 320)
    assert is_whole(out) and len(list((out / "views").glob("*.png"))) == 6
    assert run("generate", out / "views", "--output", tmp_path / "again") == 0
    assert torch.equal(pipeline[1][0].images, views.images)


def test_views_that_are_given_are_not_drawn_and_the_report_says_so(pipeline, drawn, picture, tmp_path):
    out = tmp_path / "out"
    assert run("generate", picture, "--output", out, *MULTIVIEW) == 0
    for views in (out / "views", out / "views" / "transforms.json"):
        assert run("generate", views, "--output", tmp_path / "again", *MULTIVIEW, "--reseed", "2") == 0
        notes = json.loads((tmp_path / "again" / "report.json").read_text())["left_out"]
        assert "--multiview zero123plus" in [note["what"] for note in notes]
    assert len(drawn) == 1


def test_one_view_is_drawn_anew_by_its_number(pipeline, drawn, picture, tmp_path):
    out = tmp_path / "out"
    assert run("generate", picture, "--output", out, *MULTIVIEW) == 0
    assert run("generate", picture, "--output", out, *MULTIVIEW, "--reseed", "1,4", "--seed", "9") == 0
    assert [seeds for _, seeds in drawn] == [(0,) * 6, (0, 9, 0, 0, 9, 0)]


def test_missing_multiview_weights_are_one_line(pipeline, picture, tmp_path, capsys):
    words = ["--multiview", "zero123plus", "--multiview-model", tmp_path / "gone"]
    assert run("generate", picture, "--output", tmp_path / "out", *words) == 1
    assert "gone: no such folder" in only_line(capsys.readouterr().err)
    assert not (tmp_path / "out").exists() and pipeline == []


def test_each_item_of_a_batch_has_its_own_six_views(pipeline, drawn, tmp_path, capsys):
    a_picture(tmp_path / "a.png")
    a_picture(tmp_path / "b.png")
    (tmp_path / "list.csv").write_text("views,seed\na.png,1\nb.png,2\n")
    assert run("batch", tmp_path / "list.csv", "--output", tmp_path / "out", *MULTIVIEW) == 0
    assert [(config.folder.parent.name, seeds[0]) for config, seeds in drawn] == [("a", 1), ("b", 2)]


def test_the_ground_is_under_the_object(pipeline, picture, tmp_path):
    assert run("generate", picture, "--output", tmp_path / "out", "--place", "ground") == 0
    found = trimesh.load(tmp_path / "out" / "cup.glb").geometry["cup"]
    np.testing.assert_allclose(found.bounds, [[-0.5, 0.0, -0.5], [0.5, 1.0, 0.5]], atol=1e-6)  # glTF: Y is up


def test_progress_is_shown_on_demand(pipeline, picture, tmp_path, capsys):
    assert run("generate", picture, "--output", tmp_path / "out", "--progress", "always") == 0
    messages = [line.partition("% ")[2] for line in capsys.readouterr().err.splitlines()]
    wanted = ["starting", "reading cup.png", "shaping", "writing textures", "writing cup.glb", "writing report.json"]
    assert [message for message in messages if message in wanted] == wanted


def test_a_terminal_is_written_to_only_for_what_is_new():
    """Before each block of a network the same report comes again."""
    stream = io.StringIO()
    stream.isatty = lambda: True
    line = ProgressLine(stream)
    for fraction, message in [(0.0, "a"), (0.0, "a"), (0.5, "a"), (0.5, "a"), (0.5, "b")]:
        line(fraction, message)
    assert stream.getvalue().split("\r\x1b[K") == ["", "  0% a", " 50% a", " 50% b"]
    line.clear()
    line(0.5, "b")
    assert stream.getvalue().endswith(" 50% b")


def broken_inputs(folder: Path) -> dict[str, tuple[Path, str]]:
    """Each bad input, and the name that the error has to say."""
    good = a_picture(folder / "good.png")
    (folder / "truncated.png").write_bytes(good.read_bytes()[: good.stat().st_size // 2])
    (folder / "text.png").write_text("no picture")
    write_png(folder / "empty.png", torch.zeros(4, 64, 64), srgb=True)
    write_png(folder / "busy.png", torch.rand(3, 64, 64), srgb=True)
    (folder / "bare").mkdir()
    (folder / "bad").mkdir()
    (folder / "bad" / "transforms.json").write_text("{")
    (folder / "sizes").mkdir()
    for index in range(6):
        a_picture(folder / "sizes" / f"{index}.png")
    write_png(folder / "sizes" / "5.png", torch.ones(4, 32, 32), srgb=True)
    names = {name: folder / name for name in ("truncated.png", "text.png", "empty.png", "busy.png", "bare", "missing")}
    return {name: (path, path.name) for name, path in names.items()} | {
        "malformed transforms": (folder / "bad", "transforms.json"),
        "different sizes": (folder / "sizes", "5.png"),
    }


CASES = ["truncated.png", "text.png", "empty.png", "busy.png", "bare", "missing"]
CASES += ["malformed transforms", "different sizes"]


@pytest.mark.parametrize("case", CASES)
def test_a_bad_input_is_one_line_that_names_it(pipeline, tmp_path, capfd, case):
    views, name = broken_inputs(tmp_path)[case]
    assert run("generate", views, "--output", tmp_path / "out") == 1
    captured = capfd.readouterr()
    assert name in only_line(captured.err) and captured.out == ""
    assert not (tmp_path / "out").exists()


def test_an_error_is_one_line_whatever_the_file_is_called(pipeline, tmp_path, capsys):
    assert run("generate", tmp_path / "a\nb.png", "--output", tmp_path / "out") == 1
    assert "a b.png" in only_line(capsys.readouterr().err)


@pytest.mark.parametrize("name", ["x" * 300, os.fsdecode(b"\xff")], ids=["too long", "no UTF-8"])
def test_an_output_that_no_file_system_or_writer_takes_is_refused(pipeline, picture, tmp_path, capsys, name):
    assert run("generate", picture, "--output", tmp_path / name) == 1
    assert "choose another --output" in only_line(capsys.readouterr().err) and pipeline == []


def test_a_name_too_long_for_the_results_is_refused_before_any_work(pipeline, tmp_path, capsys):
    assert run("generate", a_picture(tmp_path / ("x" * 210 + ".png")), "--output", tmp_path / "out") == 1
    assert "rename" in only_line(capsys.readouterr().err) and pipeline == []


def test_an_unwritable_output_is_refused_before_any_work(pipeline, picture, capsys):
    assert run("generate", picture, "--output", picture / "out") == 1
    assert "cup.png" in only_line(capsys.readouterr().err) and pipeline == []


def test_missing_weights_are_one_line(picture, tmp_path, capsys, monkeypatch):
    from arm_blender import checkpoints

    monkeypatch.setattr(checkpoints.shipped, "__defaults__", (tmp_path / "weights",))
    assert run("generate", picture, "--output", tmp_path / "out") == 1
    assert "small.ray_occupancy" in only_line(capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["paint"],
        ["generate"],
        ["generate", "VIEWS"],
        ["generate", "VIEWS", "--output", "OUT", "--faces", "many"],
        ["generate", "VIEWS", "--output", "OUT", "--texture-size", "1000"],
        ["generate", "VIEWS", "--output", "OUT", "--preset", "huge"],
        ["generate", "VIEWS", "--output", "OUT", "--faces", "0"],
        ["generate", "VIEWS", "--output", "OUT", "--grid", "0"],
        ["generate", "VIEWS", "--output", "OUT", "--texture-size", "0"],
        ["generate", "VIEWS", "--output", "OUT", "--threads", "0"],
        ["generate", "VIEWS", "--output", "OUT", "--threads", "-1"],
        ["generate", "VIEWS", "--output", "OUT", "--seed", "-1"],
        ["generate", "VIEWS", "--output", "OUT", "--seed", "99999999999999999999"],
        ["generate", "VIEWS", "--output", "OUT", "--random-weights", "-1"],
        ["generate", "VIEWS", "--output", "OUT", "--precision", "half"],
        ["generate", "VIEWS", "--output", "OUT", "--weights", "nowhere"],
        ["generate", "VIEWS", "--output", "OUT", "--device", "tpu"],
        ["generate", "VIEWS", "--output", "OUT", "--device", "cuda:0"],
        ["generate", "VIEWS", "--output", "OUT", "--view-weights", "1,-1"],
        ["generate", "VIEWS", "--output", "OUT", "--fovy", "190"],
        ["generate", "VIEWS", "--output", "OUT", "--export", "glb,fbx"],
        ["generate", "VIEWS", "--output", "OUT", "--export", ","],
        ["generate", "VIEWS", "--output", "OUT", "--multiview", "magic"],
        ["generate", "VIEWS", "--output", "OUT", "--multiview", "zero123plus"],
        ["generate", "VIEWS", "--output", "OUT", *MULTIVIEW, "--multiview-steps", "0"],
        ["generate", "VIEWS", "--output", "OUT", *MULTIVIEW, "--multiview-background", "red"],
        ["generate", "VIEWS", "--output", "OUT", *MULTIVIEW, "--reseed", "6"],
        ["generate", "VIEWS", "--output", "OUT", *MULTIVIEW, "--reseed", "one"],
        ["generate", "VIEWS", "--output", "OUT", "--reseed", "1"],
        ["generate", "VIEWS", "--output", "OUT", "--multiview-model", "DIR"],
        ["batch", "VIEWS", "--output", "OUT", "--jobs", "0"],
        ["relight", "VIEWS", "--output", "OUT", "--hdri", "city", "--turntable", "0"],
        ["relight", "VIEWS", "--output", "OUT", "--hdri", "city", "--resolution", "100000"],
        ["relight", "VIEWS", "--output", "OUT", "--hdri", "city", "--rotation", "nan"],
        ["relight", "VIEWS", "--output", "OUT", "--hdri", "city", "--video"],
    ],
    ids=" ".join,
)
def test_bad_usage_is_one_line_and_status_2(pipeline, picture, tmp_path, capsys, words):
    places = {"VIEWS": picture, "OUT": tmp_path / "out"}
    assert run(*(places.get(word, word) for word in words)) == 2
    only_line(capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("device", ["cuda", "mps"])
def test_a_device_that_is_not_there_is_bad_usage(pipeline, picture, tmp_path, capsys, monkeypatch, device):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    assert run("generate", picture, "--output", tmp_path / "out", "--device", device) == 2
    assert f"--device {device}" in only_line(capsys.readouterr().err)


@pytest.fixture
def listening(monkeypatch):
    """As in a process of the command line: Ctrl-C is watched."""
    monkeypatch.setattr(interrupts, "_asked", threading.Event())
    before = signal.getsignal(signal.SIGINT)
    interrupts.watch([signal.SIGINT])
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interruption_that_an_import_swallows_still_ends_the_run(
    pipeline, picture, tmp_path, capsys, monkeypatch, listening
):
    from arm_blender import pipeline as module

    made = module.generate

    def swallowing(*args):
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        return made(*args)

    monkeypatch.setattr(module, "generate", swallowing)
    assert run("generate", picture, "--output", tmp_path / "out") == INTERRUPTED
    only_line(capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_a_process_that_listens_for_a_while_has_its_own_signals_back(listening):
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interrupts.listening():
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
    interrupts.check()


def test_an_idle_worker_remembers_an_interruption(listening):
    interrupts.watch([signal.SIGINT], idle=True)
    signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        interrupts.check()


def test_signals_that_were_switched_off_stay_off(monkeypatch):
    off = [signal.SIGTERM]
    monkeypatch.setattr(signal, "getsignal", lambda number: signal.SIG_IGN if number in off else signal.SIG_DFL)
    assert signal.SIGINT in interrupts.watched() and signal.SIGTERM not in interrupts.watched()


def test_a_library_that_is_missing_is_one_line(pipeline, picture, tmp_path, capsys, monkeypatch):
    from arm_blender import pipeline as module

    def lacking(*_):
        raise ModuleNotFoundError("No module named 'xatlas'", name="xatlas")

    monkeypatch.setattr(module, "generate", lacking)
    assert run("generate", picture, "--output", tmp_path / "out") == 1
    assert "xatlas" in (line := only_line(capsys.readouterr().err)) and "doctor" in line


def test_a_reader_that_goes_away_is_no_error():
    """As `head` does; in a process of its own, since the output has to be a pipe."""
    read, write = os.pipe()
    os.close(read)
    words = [sys.executable, "-m", "arm_blender", "weights", "list"]
    done = subprocess.run(words, cwd=ROOT, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_bug_keeps_its_traceback(pipeline, picture, tmp_path, monkeypatch):
    from arm_blender import pipeline as module

    monkeypatch.setattr(module, "generate", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run("generate", picture, "--output", tmp_path / "out")


def lines_of(text: str) -> dict[str, dict]:
    return {Path(line["output"]).name: line for line in map(json.loads, text.splitlines())}


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


def test_one_bad_item_does_not_stop_the_rest(pipeline, tmp_path, capsys):
    a_picture(tmp_path / "a.png")
    (tmp_path / "b.png").write_text("no picture")
    a_picture(tmp_path / "c.png")
    (tmp_path / "list.txt").write_text("a.png\nb.png\nc.png\n")
    assert run("batch", tmp_path / "list.txt", "--output", tmp_path / "out") == 1
    captured = capsys.readouterr()
    lines = lines_of(captured.out)
    assert [lines[name]["status"] for name in "abc"] == ["done", "failed", "done"]
    assert "b.png" in lines["b"]["error"] and "b.png" in only_line(captured.err)


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


def test_cancelling_mid_batch_leaves_only_whole_files(pipeline, tmp_path, capsys, monkeypatch):
    """Interrupted while the second item's files are written; --resume then makes what is missing, and only that."""
    from arm_blender import export

    for name in "abc":
        a_picture(tmp_path / f"{name}.png")
    (tmp_path / "list.txt").write_text("a.png\nb.png\nc.png\n")
    glb = export.FORMATS["glb"]

    def interrupted(asset, path):
        glb.write(asset, path)
        if asset.name == "b":
            raise KeyboardInterrupt

    monkeypatch.setitem(export.FORMATS, "glb", replace(glb, write=interrupted))
    batch = ["batch", tmp_path / "list.txt", "--output", tmp_path / "out"]
    assert run(*batch) == INTERRUPTED
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a"] and is_whole(tmp_path / "out" / "a")
    only_line(capsys.readouterr().err)
    monkeypatch.setitem(export.FORMATS, "glb", glb)
    assert run(*batch, "--resume") == 0
    lines = lines_of(capsys.readouterr().out)
    assert [lines[name]["status"] for name in "abc"] == ["skipped", "done", "done"]


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
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


def test_relight_without_blender_says_so(tmp_path, capsys):
    (tmp_path / "cup.blend").touch()
    words = ["--hdri", "forest", "--output", tmp_path / "out"]
    assert run("relight", tmp_path / "cup.blend", *words) == 1
    assert "bpy" in only_line(capsys.readouterr().err)
    assert run("relight", tmp_path / "no.blend", *words) == 1
    assert "no.blend" in only_line(capsys.readouterr().err)


def test_doctor_and_weights_speak(capsys):
    assert run("doctor") in (0, 1)
    assert "torch" in capsys.readouterr().out
    assert run("weights", "verify", "nonsense") == 1
    assert "nonsense" in only_line(capsys.readouterr().err)


def test_the_list_of_weights_says_where_they_lie_and_whether_they_are_whole(tmp_path, capsys, monkeypatch):
    from arm_blender import checkpoints

    shutil.copytree(checkpoints.FOLDER, tmp_path, dirs_exist_ok=True)
    with (tmp_path / "small.glossyrm.safetensors").open("ab") as file:
        file.write(b"more")
    for function in (checkpoints.shipped, checkpoints.verify, checkpoints.condition):
        monkeypatch.setattr(function, "__defaults__", (tmp_path,))
    assert run("weights", "list") == 0
    lines = capsys.readouterr().out.splitlines()
    said = dict(zip(lines[::2], lines[1::2], strict=True))
    for weights, (line, where) in zip(checkpoints.REGISTRY, said.items(), strict=True):
        assert weights.name in line and weights.licence in line and weights.enables in line
        assert str(tmp_path / weights.file_name) in where
        whole = weights.name in ("small.georm", "small.instant_albedo", "small.ray_occupancy")
        assert ("whole" in line) == whole and (weights.remedy in where) != whole
    assert "damaged" in lines[2] and "not installed" in lines[8]
    assert "1.5 GB" in next(line for line in said if "instantmesh.georm" in line)


def test_verifying_nothing_is_no_success(tmp_path, capsys, monkeypatch):
    from arm_blender import checkpoints

    monkeypatch.setattr(checkpoints.shipped, "__defaults__", (tmp_path,))
    assert run("weights", "verify") == 1
    assert "no weights" in only_line(capsys.readouterr().err)


def test_doctor_sees_what_is_damaged(tmp_path, capsys, monkeypatch):
    from arm_blender import checkpoints

    for weights in checkpoints.REGISTRY:
        (tmp_path / weights.file_name).write_bytes(b"no weights")
    monkeypatch.setattr(checkpoints.shipped, "__defaults__", (tmp_path,))
    assert run("doctor") == 1
    assert "small.georm.safetensors: damaged" in capsys.readouterr().out


@pytest.mark.parametrize("error", [ImportError("libgomp.so.1: not found"), OSError("libgomp.so.1: not found")], ids=str)
def test_doctor_names_the_library_that_torch_lacks(capsys, monkeypatch, error):
    found = importlib.import_module

    def lacking(name, *rest):
        if name == "torch":
            raise error
        return found(name, *rest)

    monkeypatch.setattr(importlib, "import_module", lacking)
    assert run("doctor") == 1
    assert "libgomp" in capsys.readouterr().out


def test_help_is_light_and_the_status_is_that_of_the_process():
    """In a process of its own, as a user starts it."""
    words = [sys.executable, "-X", "importtime", "-m", "arm_blender", "generate", "--help"]
    done = subprocess.run(words, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "--texture-size" in done.stdout
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "argparse" in imported and not imported & {"torch", "numpy", "bpy"}
    words = [sys.executable, "-m", "arm_blender", "generate", "cup.png"]
    done = subprocess.run(words, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "--output" in only_line(done.stderr)
