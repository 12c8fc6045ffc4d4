"""Work on a thread, for the preferences: it shows how far it is, can be stopped, and ends with the extension."""

import threading
import types

import pytest

pytest.importorskip("bpy")
from arm_blender.blender.setup import background  # noqa: E402

pytestmark = pytest.mark.blender

PATIENCE = 10.0
"""Seconds after which a thread is taken for lost."""


@pytest.fixture
def window(monkeypatch):
    """The background work as where Blender has a window: its timer is called by the test."""
    timers = []
    app = types.SimpleNamespace(
        background=False,
        timers=types.SimpleNamespace(
            register=lambda function, **options: timers.append(function),
            is_registered=lambda function: function in timers,
            unregister=timers.remove,
        ),
    )
    manager = types.SimpleNamespace(windows=[])
    context = types.SimpleNamespace(window_manager=manager)
    monkeypatch.setattr(background, "bpy", types.SimpleNamespace(app=app, context=context))
    yield timers
    background.stop()


def test_work_says_how_far_it_is_and_ends_with_its_result(window):
    reached, go_on, results = threading.Event(), threading.Event(), []

    def work(progress):
        progress(0.25, "a quarter")
        reached.set()
        assert go_on.wait(PATIENCE)
        return "result"

    background.start(work, results.append)
    assert reached.wait(PATIENCE) and window[0]() is not None
    assert background.progress() == (0.25, "a quarter")
    with pytest.raises(RuntimeError, match="other work is running"):
        background.start(work, results.append)
    go_on.set()
    assert background._job.join(PATIENCE) and window[0]() is None
    assert (results, background.progress(), background.error()) == (["result"], None, "")


def test_stopped_work_is_no_error_and_a_bug_is_one_line(window):
    go_on, results = threading.Event(), []

    def work(progress):
        assert go_on.wait(PATIENCE)
        progress(0.5, "half way")

    background.start(work, results.append)
    background.cancel()
    assert background.progress()[1] == "Cancelling"
    go_on.set()
    assert background._job.join(PATIENCE) and window[0]() is None
    assert background.error() == ""
    background.start(lambda progress: 1 / 0, results.append)
    assert background._job.join(PATIENCE)
    window[0]()
    assert background.error() == "Internal error: ZeroDivisionError: division by zero (see the console)"
    assert results == []


def test_disabling_ends_the_work_and_its_timer(window):
    go_on = threading.Event()

    def work(progress):
        while not go_on.wait(0.01):
            progress(0.5, "half way")

    background.start(work, lambda result: pytest.fail("concluded"))
    background.stop()
    assert window == [] and background.progress() is None
    assert not [thread for thread in threading.enumerate() if thread.name == "arm-job"]
