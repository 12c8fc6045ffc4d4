"""What the program says of itself: which weights it has, and what is missing or damaged."""

import importlib
import shutil

import pytest

from .command_line import only_line, run


def test_doctor_and_weights_speak(capsys):
    assert run("doctor") in (0, 1)
    assert "torch" in capsys.readouterr().out
    assert run("weights", "verify", "nonsense") == 1
    assert "nonsense" in only_line(capsys.readouterr().err)


def test_the_list_of_weights_says_where_they_lie_and_whether_they_are_whole(tmp_path, capsys, monkeypatch):
    from arm_blender.weight_files import checkpoints
    from arm_blender.weight_files import folder as weights_folder

    shutil.copytree(weights_folder.FOLDER, tmp_path, dirs_exist_ok=True)
    with (tmp_path / "small.finish.safetensors").open("ab") as file:
        file.write(b"more")
    for function in (checkpoints.shipped, checkpoints.verify, checkpoints.condition):
        monkeypatch.setattr(function, "__defaults__", (tmp_path,))
    assert run("weights", "list") == 0
    lines = capsys.readouterr().out.splitlines()
    said = dict(zip(lines[::2], lines[1::2], strict=True))
    for weights, (line, where) in zip(checkpoints.REGISTRY, said.items(), strict=True):
        assert weights.name in line and weights.licence in line and weights.enables in line
        assert str(tmp_path / weights.file_name) in where
        whole = weights.name.startswith("small.") and weights.name != "small.finish"
        assert ("whole" in line) == whole and (weights.remedy in where) != whole
    assert "damaged" in lines[2] and "not installed" in lines[12]
    assert "1.5 GB" in next(line for line in said if "instantmesh.georm" in line)


def test_verifying_nothing_is_no_success(tmp_path, capsys, monkeypatch):
    from arm_blender.weight_files import checkpoints

    monkeypatch.setattr(checkpoints.shipped, "__defaults__", (tmp_path,))
    assert run("weights", "verify") == 1
    assert "no weights" in only_line(capsys.readouterr().err)


def test_doctor_sees_what_is_damaged(tmp_path, capsys, monkeypatch):
    from arm_blender.weight_files import checkpoints

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
