"""Many items: a line of JSON each, and whole results alone, whatever happens to one of them or to all."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest
import torch

from arm_blender.__main__ import INTERRUPTED
from arm_blender.export import is_whole
from arm_blender.machine import files
from arm_blender.version import VERSION

from .command_line import ROOT, lines_of, only_line, run


def test_a_line_says_how_an_item_was_made(pipeline, pictures, tmp_path, capsys):
    (tmp_path / "b.png").write_text("no picture")
    assert run("batch", pictures, "--output", tmp_path / "out", "--seed", "3") == 1
    lines = lines_of(capsys.readouterr().out)
    for line in lines.values():
        assert line["seed"] == 3 and line["total_seconds"] >= 0.0
        assert line["versions"]["arm_blender"] == VERSION and line["versions"]["torch"] == torch.__version__
    assert {"views", "shape", "files"} <= lines["a"]["seconds"].keys()
    assert "b.png" in lines["b"]["error"] and "seconds" not in lines["b"]


def test_one_bad_item_does_not_stop_the_rest(pipeline, pictures, tmp_path, capsys):
    (tmp_path / "b.png").write_text("no picture")
    assert run("batch", pictures, "--output", tmp_path / "out") == 1
    captured = capsys.readouterr()
    lines = lines_of(captured.out)
    assert [lines[name]["status"] for name in "abc"] == ["done", "failed", "done"]
    assert "b.png" in lines["b"]["error"] and "b.png" in only_line(captured.err)


def test_cancelling_mid_batch_leaves_only_whole_files(pipeline, pictures, tmp_path, capsys, monkeypatch):
    """Interrupted while the second item's files are written; --resume then makes what is missing, and only that."""
    from arm_blender import export

    glb = export.FORMATS["glb"]

    def interrupted(asset, path):
        glb.write(asset, path)
        if asset.name == "b":
            raise KeyboardInterrupt

    monkeypatch.setitem(export.FORMATS, "glb", replace(glb, write=interrupted))
    batch = ["batch", pictures, "--output", tmp_path / "out"]
    assert run(*batch) == INTERRUPTED
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a"] and is_whole(tmp_path / "out" / "a")
    only_line(capsys.readouterr().err)
    monkeypatch.setitem(export.FORMATS, "glb", glb)
    assert run(*batch, "--resume") == 0
    lines = lines_of(capsys.readouterr().out)
    assert [lines[name]["status"] for name in "abc"] == ["skipped", "done", "done"]


SLOW = """
import sys, time
sys.path[:0] = [{root!r}]
for name in ("export", "relight"):
    sys.modules["arm_blender.blender." + name] = None
import torch
from arm_blender import pipeline, export
from arm_blender.commands import batch
from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh
def generate(views, settings, progress, report, mesh=None):
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    mesh = UvMesh(corners, torch.tensor([[0, 1, 2]]), corners[:, :2], torch.tensor([[0, 1, 2]]), 1)
    maps = MaterialMaps(*(torch.full((channels, 4, 4), 0.5) for channels in (3, 3, 1, 1)))
    return RelightableAsset(views.name, mesh, maps), report
from dataclasses import replace
glb = export.FORMATS["glb"]
def slow(asset, path):
    glb.write(asset, path)
    if asset.name == "b":
        path.with_suffix(".waits").touch()
        time.sleep(60)
export.FORMATS["glb"] = replace(glb, write=slow)
pipeline.generate, answer = generate, batch.answer
"""


@pytest.mark.parametrize("jobs, end", [(1, signal.SIGKILL), (2, signal.SIGINT)])
def test_whatever_ends_a_batch_leaves_only_whole_outputs(pipeline, pictures, tmp_path, capsys, jobs, end):
    """Ended in the midst of the second item's files; the next run clears what is left and makes what is missing."""
    source = SLOW.format(root=str(ROOT))
    (tmp_path / "slow.py").write_text(source)
    main_code = "import sys; from arm_blender.__main__ import main, interrupts; interrupts.watch(interrupts.watched())"
    words = ["batch", str(pictures), "--output", str(tmp_path / "out"), "--jobs", str(jobs)]
    # A shell that starts the tests in the background has them, and what they start, ignore an interrupt.
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{heed}; import slow; slow.batch.WORKER = 'slow'; {main_code}; sys.exit(main({words!r}))"
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    started = subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.DEVNULL)
    out, deadline = tmp_path / "out", time.monotonic() + 100.0
    while not (list(out.glob(f"b/{files.UNFINISHED}*/b.waits")) and is_whole(out / "a")):
        assert time.monotonic() < deadline and started.poll() is None
        time.sleep(0.05)
    started.send_signal(end)
    started.wait(30)
    assert not is_whole(out / "b") and not [path for path in (out / "b").glob("*") if path.name[0] != "."]
    assert bool(list(out.glob("b/.*"))) == (end == signal.SIGKILL)
    assert run("batch", pictures, "--output", out, "--resume") == 0
    lines = lines_of(capsys.readouterr().out)
    assert lines["a"]["status"] == "skipped" and lines["b"]["status"] == "done" and not list(out.glob("*/.*"))
