"""Files are whole or absent, and an output that cannot be is refused before any work."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from arm_blender.errors import OutputError
from arm_blender.machine import files


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


def test_json_takes_paths_as_text_and_nothing_else_that_it_does_not_know(tmp_path):
    files.write_json(tmp_path / "a.json", {"folder": Path("weights", "own"), "none": None})
    assert json.loads((tmp_path / "a.json").read_text()) == {"folder": str(Path("weights", "own")), "none": None}
    with pytest.raises(TypeError):
        files.write_json(tmp_path / "b.json", {"bad": object()})
    assert not (tmp_path / "b.json").exists()


def test_an_output_that_cannot_be_is_refused_before_anything_is_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file: is a file"):
        files.check_output(tmp_path / "file" / "deeper" / "out")
    files.check_output(tmp_path / "a" / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_what_a_killed_process_left_is_cleared_and_what_another_writes_now_stays(tmp_path):
    """One process has died in the midst of a folder and of a file; another is still at both."""
    source = f"""
import os, signal, sys
from pathlib import Path
from arm_blender.machine import files
with files.staging(Path({str(tmp_path)!r})) as stage, files.whole_file(Path({str(tmp_path)!r}, "a.png")) as part:
    (stage / "b.glb").touch()
    part.touch()
    print("written", flush=True)
    sys.stdin.read()
"""
    start = [sys.executable, "-c", source]
    dead, busy = (subprocess.Popen(start, stdin=subprocess.PIPE, stdout=subprocess.PIPE) for _ in range(2))
    for process in (dead, busy):
        process.stdout.readline()
    (tmp_path / "whole.png").touch()
    assert len(list(tmp_path.iterdir())) == 5
    dead.kill()
    dead.wait()
    files.clear_unfinished(tmp_path)
    assert (tmp_path / f".a.{busy.pid}.part.png").exists() and (tmp_path / "whole.png").exists()
    (left,) = tmp_path.glob(f"{files.UNFINISHED}*")
    assert (left / "b.glb").exists() and len(list(tmp_path.iterdir())) == 3
    with files.staging(tmp_path):
        assert left.exists()
    busy.stdin.close()
    busy.wait()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "whole.png"]


def test_without_locks_only_what_is_old_is_cleared(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "fcntl", None)
    for name in ("old", "new"):
        (tmp_path / f"{files.UNFINISHED}{name}").mkdir()
    os.utime(tmp_path / f"{files.UNFINISHED}old", (0, 0))
    files.clear_unfinished(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f"{files.UNFINISHED}new"]


def test_a_folder_with_nothing_but_leftovers_goes_with_them(tmp_path):
    (tmp_path / "out" / f"{files.UNFINISHED}x").mkdir(parents=True)
    files.clear_unfinished(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def claimed(directory: Path) -> None:
    with files.only_writer(directory):
        pass


def test_a_folder_has_one_writer_until_it_is_done_or_dead(tmp_path):
    source = f"""
import sys
from pathlib import Path
from arm_blender.machine import files
with files.only_writer(Path({str(tmp_path / "out")!r})):
    print("inside", flush=True)
    sys.stdin.read()
"""
    other = subprocess.Popen([sys.executable, "-c", source], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    other.stdout.readline()
    with pytest.raises(OutputError, match="another run writes here; wait for it, or choose another --output"):
        claimed(tmp_path / "out")
    claimed(tmp_path / "elsewhere")
    other.kill()
    other.wait()
    with pytest.raises(RuntimeError), files.only_writer(tmp_path / "out"):
        raise RuntimeError
    claimed(tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())


def test_without_locks_a_file_stands_for_the_writer(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "fcntl", None)
    mark = tmp_path / "out" / ".writer"
    with pytest.raises(RuntimeError), files.only_writer(tmp_path / "out"):
        assert f"process {os.getpid()} of " in mark.read_text()
        with pytest.raises(OutputError, match=f"wait for it, or remove {mark} if it has ended"):
            claimed(tmp_path / "out")
        assert mark.exists()
        raise RuntimeError
    claimed(tmp_path / "out")
    mark.touch()  # As a killed process leaves it.
    with pytest.raises(OutputError):
        claimed(tmp_path / "out")


def test_a_folder_that_cannot_be_has_no_writer(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file: is a file"):
        claimed(tmp_path / "file")
