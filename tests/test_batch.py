"""Many items: one line of JSON each, in this process or in others, whatever happens to one of them or to all."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
import torch
import trimesh

from arm_blender import files
from arm_blender.__main__ import main
from arm_blender.commands import batch, workers
from arm_blender.export import is_whole
from arm_blender.structures import MaterialMaps, RelightableAsset, UvMesh
from arm_blender.version import VERSION
from arm_blender.views.image_io import write_png

ROOT = Path(__file__).parents[1]

STAND_IN = """
import os, signal, sys, time
from pathlib import Path
here = Path(__file__).parent
def answer(item, words):
    (here / f"{item}.begun").write_text(str(os.getpid()))
    print("chatter")
    sys.stdout.flush()
    if item == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    if item == "endless":
        from arm_blender.commands import interrupts
        try:
            while True:
                time.sleep(0.02)
                interrupts.check()
        except KeyboardInterrupt:
            (here / "cleared").touch()
            raise
    time.sleep(words.get("seconds", 0.0))
    return {"item": item, "process": os.getpid(), "threads": os.environ["OMP_NUM_THREADS"], **words}
"""
"""What workers do here: light, and deadly when asked to be."""


@pytest.fixture
def stand_in(tmp_path, monkeypatch) -> str:
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    monkeypatch.syspath_prepend(str(tmp_path))
    return "stand_in"


def test_every_item_is_answered_by_processes_that_share_the_cores(stand_in):
    items = [f"{number}" for number in range(6)]
    answers = dict(workers.side_by_side(items, 2, stand_in, {"seconds": 0.05}))
    assert sorted(answers) == items and all(answers[item]["item"] == item for item in items)
    assert 1 <= len({answer["process"] for answer in answers.values()}) <= 2
    assert os.getpid() not in {answer["process"] for answer in answers.values()}
    assert {answer["threads"] for answer in answers.values()} == {str(workers.threads_of_each(2))}


def test_threads_of_all_processes_are_no_more_than_the_cores(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert [workers.threads_of_each(count) for count in (1, 2, 3, 8, 20)] == [8, 4, 2, 1, 1]


def test_a_process_that_dies_takes_only_its_own_item(stand_in):
    items = ["a", "deadly", "b", "c"]
    answers = dict(workers.side_by_side(items, 1, stand_in, {}))
    assert answers.pop("deadly") is None
    assert {item: answer["item"] for item, answer in answers.items()} == {item: item for item in "abc"}


def test_leaving_early_stops_every_process_after_it_has_cleared_up(stand_in, tmp_path):
    with closing(workers.side_by_side(["endless", "a", "b"], 2, stand_in, {})) as answers:
        next(answers)
        wait_for(tmp_path / "endless.begun")
    assert (tmp_path / "cleared").exists()
    assert not alive(int((tmp_path / "endless.begun").read_text()))


def test_a_worker_does_not_outlive_the_process_that_asks(stand_in, tmp_path):
    source = f"""
import sys
sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]
from arm_blender.commands import workers
list(workers.side_by_side(["endless"], 2, "stand_in", {{}}))
"""
    parent = subprocess.Popen([sys.executable, "-c", source])
    wait_for(tmp_path / "endless.begun")
    parent.kill()
    parent.wait()
    wait_for(tmp_path / "cleared")


def wait_for(path: Path) -> None:
    deadline = time.monotonic() + 60.0
    while not (path.exists() and (path.name == "cleared" or path.read_text())):
        assert time.monotonic() < deadline, f"{path} never came"
        time.sleep(0.02)


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture
def pipeline(monkeypatch):
    """Stands in for the pipeline: a box for every view set; keeps the settings that it was asked for."""
    from arm_blender import pipeline

    calls = []

    def generate(views, settings, progress, report, mesh=None):
        calls.append(settings)
        with report.stage("shape"):
            box = trimesh.creation.box()
        vertices, faces = torch.from_numpy(box.vertices.copy()).float(), torch.from_numpy(box.faces.copy()).long()
        mesh = UvMesh(vertices, faces, torch.rand(len(vertices), 2), faces, 1)
        maps = MaterialMaps(*(torch.full((channels, 4, 4), 0.5) for channels in (3, 3, 1, 1)))
        return RelightableAsset(views.name, mesh, maps), report

    monkeypatch.setattr(pipeline, "generate", generate)
    for name in ("export", "relight"):
        monkeypatch.setitem(sys.modules, f"arm_blender.blender.{name}", None)
    return calls


@pytest.fixture
def pictures(tmp_path) -> Path:
    """A list of three pictures of a square."""
    image = torch.zeros(4, 64, 64)
    image[:, 16:48, 20:44] = 1.0
    for name in "abc":
        write_png(tmp_path / f"{name}.png", image, srgb=True)
    (tmp_path / "list.txt").write_text("a.png\nb.png\nc.png\n")
    return tmp_path / "list.txt"


def run(*words) -> int:
    return main([str(word) for word in words])


def lines_of(text: str) -> dict[str, dict]:
    return {Path(line["output"]).name: line for line in map(json.loads, text.splitlines())}


def test_a_line_says_how_an_item_was_made(pipeline, pictures, tmp_path, capsys):
    (tmp_path / "b.png").write_text("no picture")
    assert run("batch", pictures, "--output", tmp_path / "out", "--seed", "3") == 1
    lines = lines_of(capsys.readouterr().out)
    for line in lines.values():
        assert line["seed"] == 3 and line["total_seconds"] >= 0.0
        assert line["versions"]["arm_blender"] == VERSION and line["versions"]["torch"] == torch.__version__
    assert {"views", "shape", "files"} <= lines["a"]["seconds"].keys()
    assert "b.png" in lines["b"]["error"] and "seconds" not in lines["b"]


def test_an_item_says_for_itself_what_differs(pipeline, pictures, tmp_path, capsys):
    (tmp_path / "list.csv").write_text(
        "views,quality,seed,faces,texture_size,blend,place\n"
        "a.png,final,7,500,512,sharpest,ground\n"
        "b.png,,,,,,\n"
        "c.png,best,,,,,\n"
    )
    assert run("batch", tmp_path / "list.csv", "--output", tmp_path / "out", "--quality", "draft") == 1
    lines = lines_of(capsys.readouterr().out)
    own, common = pipeline
    assert (own.quality, own.seed, own.faces, own.texture_size, own.blend) == ("final", 7, 500, 512, "sharpest")
    assert (common.quality, common.seed, common.faces) == ("draft", 0, None)
    assert lines["a"]["seed"] == 7 and "--quality best" in lines["c"]["error"]
    feet = {name: trimesh.load(tmp_path / "out" / name / f"{name}.glb").bounds[0, 1] for name in "ab"}
    assert feet == pytest.approx({"a": 0.0, "b": -0.5}, abs=1e-6)


def test_help_names_every_option_of_an_item(capsys):
    assert run("batch", "--help") == 0
    said = capsys.readouterr().out
    assert all(column in said for column in batch._COLUMNS)


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
