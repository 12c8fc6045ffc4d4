"""The report adds up, and its file is whole or absent."""

import json
import tomllib
from pathlib import Path

import pytest

from arm_blender import files
from arm_blender.errors import OutputError
from arm_blender.report import Report
from arm_blender.version import VERSION

ROOT = Path(__file__).parents[1]


def test_stages_keep_their_order_and_add_up(monkeypatch):
    now = iter([0.0, 2.0, 10.0, 11.0, 20.0, 20.5])
    monkeypatch.setattr("arm_blender.report.time.perf_counter", lambda: next(now))
    report = Report("small", "cpu", 7)
    with report.stage("shape"):
        pass
    with report.stage("unwrap"):
        pass
    with pytest.raises(KeyError), report.stage("shape"):
        raise KeyError
    assert list(report.seconds.items()) == [("shape", 2.5), ("unwrap", 1.0)]
    assert report.as_dict()["total_seconds"] == 3.5


def test_the_file_says_what_the_run_was(tmp_path):
    report = Report("small", "cpu", 7, faces=10, charts=2, texture_size=512, seen_share=0.25)
    report.leave_out("a.blend", "no bpy")
    report.leave_out("a.blend", "no bpy")
    report.write(tmp_path / "report.json")
    data = json.loads((tmp_path / "report.json").read_text())
    assert data["version"] == VERSION and data["preset"] == "small" and data["seed"] == 7
    assert (data["faces"], data["charts"], data["texture_size"], data["seen_share"]) == (10, 2, 512, 0.25)
    assert data["left_out"] == [{"what": "a.blend", "why": "no bpy"}]
    assert data["peak_memory_mib"] > 1.0


def test_a_write_that_fails_leaves_the_older_file(tmp_path):
    path = tmp_path / "report.json"
    files.write_json(path, {"old": True})
    with pytest.raises(ValueError):
        files.write_json(path, {"bad": float("nan")})
    with pytest.raises(RuntimeError), files.whole_file(path) as temporary:
        temporary.write_text("half of it")
        raise RuntimeError
    assert json.loads(path.read_text()) == {"old": True}
    assert list(tmp_path.iterdir()) == [path]


def test_an_output_that_cannot_be_is_refused_before_anything_is_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file: is a file"):
        files.check_output(tmp_path / "file" / "deeper" / "out")
    files.check_output(tmp_path / "a" / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_every_place_that_states_the_version_agrees():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == VERSION


def test_every_dependency_is_pinned():
    """What `make` installs covers what the package declares, each at one exact version."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pins = {}
    for name in ("requirements.txt", "requirements-dev.txt"):
        for line in (ROOT / name).read_text(encoding="utf-8").splitlines():
            if line and line[0] not in "#-":
                package, _, version = line.partition("==")
                pins[package.lower()] = version
    assert all(pins.values())
    extras = project["optional-dependencies"].values()
    declared = [*project["dependencies"], *(entry for extra in extras for entry in extra)]
    assert {entry.partition(">=")[0].lower() for entry in declared} == set(pins)
