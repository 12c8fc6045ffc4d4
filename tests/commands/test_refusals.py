"""What is refused: in one line that names it, with its status, before any work and with nothing left behind."""

import os
from pathlib import Path

import pytest
import torch

from arm_blender.views.image_io import write_png

from ..pictures import a_picture
from .command_line import MULTIVIEW, only_line, run


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
    from arm_blender.weight_files import checkpoints

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


def test_a_library_that_is_missing_is_one_line(pipeline, picture, tmp_path, capsys, monkeypatch):
    from arm_blender import pipeline as module

    def lacking(*_):
        raise ModuleNotFoundError("No module named 'xatlas'", name="xatlas")

    monkeypatch.setattr(module, "generate", lacking)
    assert run("generate", picture, "--output", tmp_path / "out") == 1
    assert "xatlas" in (line := only_line(capsys.readouterr().err)) and "doctor" in line


def test_relight_without_blender_says_so(tmp_path, capsys):
    (tmp_path / "cup.blend").touch()
    words = ["--hdri", "forest", "--output", tmp_path / "out"]
    assert run("relight", tmp_path / "cup.blend", *words) == 1
    assert "bpy" in only_line(capsys.readouterr().err)
    assert run("relight", tmp_path / "no.blend", *words) == 1
    assert "no.blend" in only_line(capsys.readouterr().err)
