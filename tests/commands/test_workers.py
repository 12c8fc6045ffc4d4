"""Processes side by side: every item is answered, and nobody outlives who asks."""

import os
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from arm_blender.commands import workers

from .command_line import ROOT

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
    threads = os.environ["OMP_NUM_THREADS"]
    return {"item": item, "process": os.getpid(), "threads": threads, "group": os.getpgid(0), **words}
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


@pytest.mark.skipif(sys.platform == "win32", reason="it has no groups that a terminal interrupts")
def test_a_key_that_interrupts_does_not_reach_workers(stand_in):
    """Those who are still starting would print tracebacks; we tell them to leave."""
    found = dict(workers.side_by_side(["a"], 1, stand_in, {}))
    assert found["a"]["group"] != os.getpgid(0)


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
