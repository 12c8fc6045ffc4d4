"""The report adds up, and its file says what the run was."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from arm_blender.report import Report
from arm_blender.version import VERSION


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
    report.note_mask("1.jpg", "small network")
    for name in "1234":
        report.note_mask(f"{name}.jpg", "doubtful: it is torn")
    report.doubt("the pictures disagree")
    report.doubt("the pictures disagree")
    report.write(tmp_path / "report.json")
    data = json.loads((tmp_path / "report.json").read_text())
    assert data["version"] == VERSION and data["preset"] == "small" and data["seed"] == 7
    torn = "the mask of 1.jpg, 2.jpg, 3.jpg and 1 more: it is torn"
    assert data["doubts"] == ["the pictures disagree", torn], "however often it is said"
    assert data["masks"] == {"small network": ["1.jpg"]}
    assert (data["faces"], data["charts"], data["texture_size"], data["seen_share"]) == (10, 2, 512, 0.25)
    assert data["left_out"] == [{"what": "a.blend", "why": "no bpy"}]
    assert data["peak_memory_mib"] > 1.0


def test_a_process_does_not_count_the_memory_of_the_one_that_started_it():
    """As the operating system does where a large process starts a small one."""
    large = bytearray(b"x" * (400 << 20))
    code = "from arm_blender.report import peak_memory_mib; print(peak_memory_mib())"
    done = subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[1], capture_output=True, text=True)
    assert float(done.stdout) < 300.0 < len(large) / 2**20
