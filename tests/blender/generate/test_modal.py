"""The operator behind a window: it polls, cancels on Esc, and lets go of everything in each way that it can end."""

import re
import threading
import types
from functools import partial

import pytest

from arm_blender.errors import Cancelled

bpy = pytest.importorskip("bpy")
from arm_blender.blender.generate import operators  # noqa: E402
from arm_blender.blender.input.generation_request import GenerationRequest  # noqa: E402

pytestmark = pytest.mark.blender

PATIENCE = 10.0
TIMER = types.SimpleNamespace(type="TIMER", value="NOTHING")
ESCAPE = types.SimpleNamespace(type="ESC", value="PRESS")
MOUSE = types.SimpleNamespace(type="MOUSEMOVE", value="NOTHING")


class Window:
    """What the operator asks of a window manager and a workspace, remembered."""

    def __init__(self):
        self.arm = types.SimpleNamespace(fraction=0.0, message="", time="", error="")
        self.windows, self.timers, self.handlers, self.status = [], set(), [], None

    def event_timer_add(self, seconds, window):
        self.timers.add("timer")
        return "timer"

    def event_timer_remove(self, timer):
        self.timers.remove(timer)

    def modal_handler_add(self, operator):
        self.handlers.append(operator)

    def status_text_set(self, text):
        self.status = text

    def progress_begin(self, low, high): ...

    def progress_update(self, value): ...

    def progress_end(self): ...


@pytest.fixture
def window() -> Window:
    return Window()


@pytest.fixture
def context(window):
    return types.SimpleNamespace(window_manager=window, window=None, workspace=window)


@pytest.fixture
def operator(monkeypatch, tmp_path):
    """The operator's own methods on a plain object: Blender makes instances of its classes for itself only."""
    shown = types.SimpleNamespace(app=types.SimpleNamespace(background=False))
    monkeypatch.setattr(operators, "bpy", shown)
    wanted = GenerationRequest(tmp_path, quality="draft")
    monkeypatch.setattr(operators.request, "from_panel", lambda context, filepath: wanted)
    classes = (operators.Run, operators.ARM_OT_generate)
    methods = {name: value for cls in classes for name, value in vars(cls).items() if callable(value)}
    made = type("Driven", (), {**methods, "filepath": ""})()
    made.reports = []
    made.report = lambda kind, message: made.reports.append((kind, message))
    return made


@pytest.fixture
def work(monkeypatch):
    """A pipeline that reports, waits to be let go on, and reports again."""
    state = types.SimpleNamespace(reached=threading.Event(), go_on=threading.Event(), end=None)

    def pipeline(request, progress):
        progress(0.25, "a quarter")
        state.reached.set()
        assert state.go_on.wait(PATIENCE)
        progress(0.5, "half way")
        raise state.end

    monkeypatch.setattr(operators, "generate", pipeline)
    yield state
    state.go_on.set()


def start(operator, context, work):
    assert operator.invoke(context, MOUSE) == {"RUNNING_MODAL"}
    assert work.reached.wait(PATIENCE)
    assert operators.is_running()


def assert_all_is_released(window):
    assert not operators.is_running()
    assert (window.timers, window.status) == (set(), None)
    assert (window.arm.fraction, window.arm.message, window.arm.time) == (0.0, "", "")


def test_progress_reaches_the_panel_while_events_pass_through(operator, context, window, work):
    start(operator, context, work)
    assert operator.modal(context, MOUSE) == {"PASS_THROUGH"}
    assert operator.modal(context, TIMER) == {"PASS_THROUGH"}
    assert (window.arm.fraction, window.arm.message) == (0.25, "a quarter")
    assert "Esc" in window.status
    assert re.fullmatch(r"0:0\d, about \d+:\d\d left", window.arm.time)
    work.go_on.set()
    operator.cancel(context)
    assert_all_is_released(window)


def test_escape_ends_at_the_next_report(operator, context, window, work):
    start(operator, context, work)
    assert operator.modal(context, ESCAPE) == {"RUNNING_MODAL"}
    assert (window.arm.message, window.status) == ("Cancelling", "Cancelling")
    assert operator.modal(context, TIMER) == {"PASS_THROUGH"}, "the thread has not noticed yet"
    assert window.arm.message == "Cancelling", "an older report must not hide it"
    work.go_on.set()
    assert operator._job.join(PATIENCE)
    assert operator.modal(context, TIMER) == {"CANCELLED"}
    assert operator.reports == [({"INFO"}, "Generation cancelled")]
    assert_all_is_released(window)


def test_a_failure_is_reported_and_releases_the_window(operator, context, window, work):
    work.end = ValueError("shape (3, 4)")
    start(operator, context, work)
    work.go_on.set()
    assert operator._job.join(PATIENCE)
    assert operator.modal(context, TIMER) == {"CANCELLED"}
    ((kind, message),) = operator.reports
    assert kind == {"ERROR"} and "shape (3, 4)" in message
    assert window.arm.error == message
    assert_all_is_released(window)


def test_quitting_waits_for_the_thread(operator, context, window, work):
    start(operator, context, work)
    threading.Timer(0.2, work.go_on.set).start()
    context.workspace = None  # There is none while Blender quits.
    window.status = None
    operator.cancel(context)
    assert operator._job.finished
    assert isinstance(operator._job.error, Cancelled)
    assert_all_is_released(window)


def test_disabling_waits_for_a_thread_that_loading_a_file_did_not_wait_for(operator, context, work, monkeypatch):
    start(operator, context, work)
    monkeypatch.setattr(operators, "_QUIT_PATIENCE", 0.05)
    operator.cancel(context)
    assert not operator._job.finished and not operators.is_running()
    monkeypatch.setattr(operators, "_QUIT_PATIENCE", PATIENCE)
    threading.Timer(0.2, work.go_on.set).start()
    operators.stop_all()
    assert operator._job.finished


def test_a_second_run_is_refused_while_one_runs(operator, context, window, work):
    start(operator, context, work)
    refused = []
    cls = types.SimpleNamespace(poll_message_set=refused.append)
    assert operators.Run.poll.__func__(cls, context) is False
    assert refused == ["A generation is running"]
    work.go_on.set()
    operator.cancel(context)
    assert operators.Run.poll.__func__(cls, context) is True


def test_only_sidebars_are_drawn_anew_and_only_where_something_changed(operator, context, window, work, monkeypatch):
    """Drawing the scene may take seconds; a tick of the timer must not ask for it."""
    drawn = []
    monkeypatch.setattr(operators.Job, "elapsed", 1.0)
    kinds = ("UI", "WINDOW")
    regions = [types.SimpleNamespace(type=kind, tag_redraw=partial(drawn.append, kind)) for kind in kinds]
    area = types.SimpleNamespace(type="VIEW_3D", regions=regions)
    window.windows = [types.SimpleNamespace(screen=types.SimpleNamespace(areas=[area]))]
    start(operator, context, work)
    operator.modal(context, TIMER)
    assert set(drawn) == {"UI"}
    window.arm.fraction, window.arm.message, window.arm.time = 0.25, "a quarter", ""
    count = len(drawn)
    operator.modal(context, TIMER)
    operator.modal(context, TIMER)
    assert len(drawn) == count + 1, "once for the time that was cleared"
    work.go_on.set()
    operator.cancel(context)
