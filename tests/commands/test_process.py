"""The command line as a process: its signals, its pipes, its tracebacks, and what it imports."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress

import pytest

from arm_blender.__main__ import INTERRUPTED
from arm_blender.commands import interrupts

from .command_line import ROOT, only_line, run


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
