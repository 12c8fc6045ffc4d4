"""One scenario in a Blender with a window; `tools/window_run.py` starts a Blender for each. Runs inside Blender.

A scenario is a generator on Blender's main thread: what it yields are the seconds until it goes on, while Blender's own
events pass. What it finds goes to /mnt/out as JSON. Mouse and keyboard are Blender's simulated events.
"""

import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import addon_utils
import bpy

EXTENSION = "bl_ext.user_default.arm_blender"
OUT, PROJECT = Path("/mnt/out"), Path("/mnt/project")
VIEWS = str(PROJECT / "examples" / "barrel")
ESC_AT = 400, 400
"""A pixel of the 3D view, where no button is."""
TICK, STEP = 0.02, 0.005
"""Seconds between two ticks of the clock that is watched, and between two looks for an event."""
REDRAW = 0.1
"""Seconds from redraw to redraw of the panel: as often as the extension itself looks at its job. Drawn by the
processor, more of them would take from the run what a graphics card does not."""

Scenario = Iterator[float]


class Watch:
    """When timers fired, the panel was drawn, and the thread reported; seconds on one clock."""

    def __init__(self) -> None:
        self.ticks: list[float] = []
        self.draws: list[tuple[float, str]] = []
        self.reports: list[tuple[float, str]] = []
        self._asked = 0.0
        bpy.app.timers.register(self._tick, persistent=True)

    def _tick(self) -> float:
        self.ticks.append(time.perf_counter())
        if self.ticks[-1] - self._asked >= REDRAW:
            self._asked = self.ticks[-1]
            next(region for region in area().regions if region.type == "UI").tag_redraw()
        return TICK

    def attach(self) -> None:
        """Listen to the panel's draws, and to the reports of jobs, as the extension has them now."""
        panel, job = module("panels").ARM_PT_generate, module("job").Job
        draw, report = panel.draw, job._progress

        def drawn(shown, context) -> None:
            draw(shown, context)
            self.draws.append((time.perf_counter(), context.window_manager.arm.message))

        def reported(own, fraction: float, message: str) -> None:
            self.reports.append((time.perf_counter(), message))
            report(own, fraction, message)

        panel.draw, job._progress = drawn, reported

    def intervals(self, since: float) -> dict[str, dict[str, float]]:
        """Of timer events and of redraws: the longest interval and the 95th percentile."""
        found = {}
        for name, moments in (("timer events", self.ticks), ("redraws", [moment for moment, _ in self.draws])):
            inside = [moment for moment in moments if moment >= since]
            gaps = sorted(b - a for a, b in zip(inside, inside[1:], strict=False))
            found[name] = {"longest": gaps[-1], "p95": gaps[int(0.95 * (len(gaps) - 1))], "number": len(gaps)}
        return found

    def silences(self, since: float) -> dict[str, float]:
        """For each stage of a run the longest time that the thread went without a report: how late a stop may come."""
        inside = [(moment, stage_of(message)) for moment, message in self.reports if moment >= since]
        inside.append((time.perf_counter(), "end"))
        longest: dict[str, float] = {}
        for (begin, stage), (end, _) in zip(inside, inside[1:], strict=False):
            longest[stage] = max(longest.get(stage, 0.0), end - begin)
        return longest


def run(watch: Watch) -> Scenario:
    """Click Generate, wait for the result, undo it."""
    before = set(bpy.data.objects.keys())
    began = time.perf_counter()
    job = yield from click_generate()
    while module("operators").is_running():
        yield STEP
    seconds = time.perf_counter() - began
    made = set(bpy.data.objects.keys()) - before
    silences = {stage: value for stage, value in watch.silences(began).items() if stage != "end"}
    result = {"seconds": seconds, "made": len(made), "error": state().error, "silences": silences}
    result["intervals"] = watch.intervals(began)
    assert job.result is not None, state().error
    with in_view():
        bpy.ops.ed.undo()
    yield 0.5
    return result | {"left after undo": len(made & set(bpy.data.objects.keys()))}


def cancel(watch: Watch) -> Scenario:
    """Esc at every stage: how long until the panel says so, and until the thread has ended."""
    begun = time.perf_counter()
    yield from click_generate()
    while module("operators").is_running():
        yield STEP
    stages = list(dict.fromkeys(stage_of(message) for moment, message in watch.reports if moment >= begun))
    rows = dict.fromkeys(stages)
    for stage in stages:
        began = time.perf_counter()
        job = yield from click_generate()
        while not job.finished and not any(t >= began and stage_of(said) == stage for t, said in watch.reports[-400:]):
            yield STEP
        pressed = time.perf_counter()
        window().event_simulate(type="ESC", value="PRESS", x=ESC_AT[0], y=ESC_AT[1])
        window().event_simulate(type="ESC", value="RELEASE", x=ESC_AT[0], y=ESC_AT[1])
        while not job.finished:
            yield STEP
        ended = time.perf_counter() - pressed
        while module("operators").is_running():
            yield STEP
        said = [moment - pressed for moment, message in watch.draws if moment > pressed and message == "Cancelling"]
        rows[stage] = {"said": said[0] if said else None, "ended": ended, "stopped": job.result is None}
        (OUT / "cancel.json").write_text(json.dumps({"stages": rows}))  # What is there if the time is over.
        yield 0.3
    return {"stages": rows}


def load(watch: Watch) -> Scenario:
    """Open another file while a run is going on; then run once more."""
    path = str(OUT / "other.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
    job = yield from begin_run()
    began = time.perf_counter()
    with bpy.context.temp_override(window=window()):
        bpy.ops.wm.open_mainfile(filepath=path)
    seconds = time.perf_counter() - began
    result = {"seconds": seconds, "ended": job.finished, "running": module("operators").is_running()}
    yield 0.5
    second = yield from begin_run()
    module("operators")._cancel(bpy.context, second)
    while module("operators").is_running():
        yield STEP
    return result | {"runs again": True}


def leave(watch: Watch) -> Scenario:
    """Quit while a run is going on; the exit code says the rest."""
    yield from begin_run()
    return {"running": module("operators").is_running()}


def disable(watch: Watch) -> Scenario:
    """Disable the extension while a run is going on, and enable it again."""
    job = yield from begin_run()
    began = time.perf_counter()
    addon_utils.disable(EXTENSION)
    result = {"seconds": time.perf_counter() - began, "ended": job.finished}
    gone = not hasattr(bpy.types.Scene, "arm")
    yield 1.0
    addon_utils.enable(EXTENSION)
    yield 1.0
    return result | {"gone": gone, "back": hasattr(bpy.types.Scene, "arm")}


def pictures(watch: Watch) -> Scenario:
    """The panel idle, running, failed and done; nothing is measured here."""
    shoot("idle")
    yield 0.5
    yield from click_generate()
    yield 2.5
    shoot("running")
    while module("operators").is_running():
        yield 0.2
    space = area().spaces.active
    space.shading.type, space.region_3d.view_distance = "MATERIAL", 3.0
    yield 20.0  # Shaders are compiled by the processor here.
    shoot("done")
    space.shading.type = "SOLID"
    bpy.context.scene.arm.views_path = VIEWS.replace("barrel", "barel")
    yield 1.0
    with in_view():
        bpy.ops.arm.generate("INVOKE_DEFAULT")
    yield 2.0
    shoot("failed")
    return {}


def click_generate() -> Scenario:
    """Press the panel's button with the mouse; the job that it starts."""
    ready = module("operators")
    x, y = json.loads(os.environ["ARM_BUTTON"])
    for aside in (40, 2, 0):  # The first move finds the sidebar, the next its button.
        window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x + aside, y=y)
        yield 0.2
    for value in ("PRESS", "RELEASE"):
        window().event_simulate(type="LEFTMOUSE", value=value, x=x, y=y)
        yield 0.1
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=ESC_AT[0], y=ESC_AT[1])
    for _ in range(200):
        if ready.is_running():
            return ready._running
        yield STEP
    shoot("no-button")
    raise AssertionError(f"no run begins by a click at {x}, {y}: {state().error}; see no-button.png")


def begin_run() -> Scenario:
    """A run that is at work in its networks."""
    if not bpy.context.scene.arm.views_path:
        yield from choose_views()
    with in_view():
        bpy.ops.arm.generate("INVOKE_DEFAULT")
    yield 2.0
    assert module("operators").is_running(), state().error
    return module("operators")._running


def choose_views() -> Scenario:
    settings = bpy.context.scene.arm
    settings.quality, settings.views_path = "draft", VIEWS
    yield 0.3
    while module("view_list").is_looking():
        yield 0.1


def prepare(watch: Watch) -> Scenario:
    """The extension enabled, its tab in front, the views chosen."""
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    addon_utils.enable(EXTENSION, default_set=True)
    watch.attach()
    area().spaces.active.show_region_ui = True
    yield 0.5
    next(region for region in area().regions if region.type == "UI").active_panel_category = "ARM"
    yield from choose_views()
    yield 0.5


def module(name: str):
    return sys.modules[f"{EXTENSION}.arm_blender.blender.{name}"]


def window() -> bpy.types.Window:
    return bpy.context.window_manager.windows[0]


def area() -> bpy.types.Area:
    return next(area for area in window().screen.areas if area.type == "VIEW_3D")


def in_view():
    region = next(region for region in area().regions if region.type == "WINDOW")
    return bpy.context.temp_override(window=window(), area=area(), region=region)


def state():
    return bpy.context.window_manager.arm


def stage_of(message: str) -> str:
    """The pictures are one stage, whatever their names."""
    return "reading the pictures" if message.startswith("reading ") else message


def shoot(name: str) -> None:
    subprocess.run(["import", "-window", "root", OUT / f"{name}.png"], check=True)


SCENARIOS = {"run": run, "cancel": cancel, "load": load, "quit": leave, "disable": disable, "pictures": pictures}


def whole(name: str) -> Scenario:
    watch = Watch()
    yield from prepare(watch)
    result = yield from SCENARIOS[name](watch)
    (OUT / f"{name}.json").write_text(json.dumps(result, indent=1))
    bpy.ops.wm.quit_blender()
    yield 60.0


def main() -> None:
    bpy.context.preferences.view.show_splash = False  # Before the first event, or it is there.
    steps = whole(sys.argv[-1])

    def step() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            return None
        except Exception:  # Blender prints what a timer raises, and goes on for ever.
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(3)

    bpy.app.timers.register(step, first_interval=2.0, persistent=True)


main()
