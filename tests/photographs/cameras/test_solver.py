"""What becomes of the process that solves cameras: it is heard, it is stopped, and its crash is one line."""

import os
import signal
import sys
import time

import pytest

from arm_blender.errors import ArmError, Cancelled
from arm_blender.photographs.cameras.solver import Job, match, solve
from arm_blender.photographs.colmap import runner
from arm_blender.progress import silent


@pytest.fixture
def job(tmp_path):
    return Job(tmp_path, tmp_path, None, [{"width": 4, "height": 3, "focal": None, "pictures": ["a", "b"]}], 1, 0)


@pytest.fixture
def worker(tmp_path, monkeypatch):
    """Puts a program of the test's in the place of the real one."""

    def put(text: str) -> None:
        program = tmp_path / "worker.py"
        program.write_text(text, encoding="utf-8")
        monkeypatch.setattr(runner, "PROGRAM", program)

    return put


def test_progress_is_passed_on_and_other_lines_are_not(job, worker):
    worker("""print("libfoo: hello"); print('\\x1earm {"fraction": 0.5, "message": "half"}')""")
    told = []
    match(job, lambda fraction, message: told.append((fraction, message)))
    assert told[0] == (0.0, "starting pycolmap") and {message for _, message in told} <= {"starting pycolmap", "half"}


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_crash_is_one_line_with_the_remedy(job, worker):
    worker("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(ArmError, match=f"pycolmap failed .it ended with status -{int(signal.SIGSEGV)}.; try fewer"):
        match(job, silent)


def test_an_error_of_its_own_is_named(job, worker):
    worker("""import os; print('\\x1earm {"error": "ValueError: no such thing"}', flush=True); os._exit(1)""")
    with pytest.raises(ArmError, match="pycolmap failed .ValueError: no such thing."):
        match(job, silent)


def test_a_real_job_that_does_not_do_is_one_line(job):
    """The real program, asked for pictures that are not there."""
    with pytest.raises(ArmError, match="pycolmap failed"):
        solve(job, "try-0", None, silent)


def test_a_stop_ends_the_process_within_a_second(job, worker, tmp_path):
    worker(
        "import os, pathlib, sys, time\n"
        f"pathlib.Path({str(tmp_path / 'pid')!r}).write_text(str(os.getpid()))\n"
        "time.sleep(60)\n"
    )
    stopped = []

    def progress(fraction: float, message: str) -> None:
        if (tmp_path / "pid").exists() and (tmp_path / "pid").read_text():
            stopped.append(time.monotonic())
            raise Cancelled("stopped")

    with pytest.raises(Cancelled):
        match(job, progress)
    assert time.monotonic() - stopped[0] < 1.0
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_without_pycolmap_the_remedy_is_named(job, monkeypatch):
    monkeypatch.setattr(runner, "is_there", lambda module: False)
    with pytest.raises(ArmError, match="pip install pycolmap"):
        match(job, silent)


def test_nothing_solved_is_no_solution(job, worker):
    worker("""print('\\x1earm {"models": []}')""")
    assert solve(job, "try-0", None, silent) == ([], [])
