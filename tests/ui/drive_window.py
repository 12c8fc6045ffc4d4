"""One scenario in a Blender with a window; `tools/window_run.py` starts a Blender for each. Runs inside Blender.

A scenario is a generator on Blender's main thread: what it yields are the seconds until it goes on, while Blender's own
events pass. What it finds goes to /mnt/out as JSON. Mouse and keyboard are Blender's simulated events.
"""

import json
import os
import shutil
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import addon_utils
import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from finish_regions import materials
from first_run import example
from walk_photographs import photographs
from watch import Watch, stage_of
from window import ESC_AT, EXTENSION, OUT, PROJECT, area, click, in_view, module, shoot, state, window

VIEWS = str(PROJECT / "arm_blender" / "examples" / "barrel")
STEP = 0.005
"""Seconds between two looks for an event."""
SETTLED = 5.0
"""Seconds after a result until the 3D view has smoothed its edges: drawn by the processor, each redraw of the view with
a new object in it holds up every event for a quarter of a second."""
ENVIRONMENTS = ("studio", "sunset", "sunrise")
"""Those of the preview, and one whose light comes from one side."""
MOVED = 0.4
"""By how much a wrong camera is too high."""

Scenario = Iterator[float]


def run(watch: Watch) -> Scenario:
    """Click Generate, wait for the result, undo it."""
    before = set(bpy.data.objects.keys())
    began = time.perf_counter()
    job = yield from click_generate()
    while module("generate.operators").is_running():
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
    while module("generate.operators").is_running():
        yield STEP
    yield SETTLED
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
        while module("generate.operators").is_running():
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
    result = {"seconds": seconds, "ended": job.finished, "running": module("generate.operators").is_running()}
    yield 0.5
    second = yield from begin_run()
    module("generate.operators")._cancel(bpy.context, second)
    while module("generate.operators").is_running():
        yield STEP
    return result | {"runs again": True}


def leave(watch: Watch) -> Scenario:
    """Quit while a run is going on; the exit code says the rest."""
    yield from begin_run()
    return {"running": module("generate.operators").is_running()}


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


def engines(watch: Watch) -> Scenario:
    """The previews of a new asset by Cycles and by Eevee: the mean displayed colour of the object in each."""
    yield from generated()
    relight, made = module("relight.renders"), window().view_layer.objects.active
    found: dict[str, dict[str, float]] = {}
    for engine in ("cycles", "eevee"):
        config = relight.RelightConfig(engine=engine, resolution=256)
        paths = relight.relight(made, ENVIRONMENTS, OUT / engine, config)
        for environment, path in zip(ENVIRONMENTS, paths, strict=True):
            found.setdefault(environment, {})[engine] = mean_color(path)
            yield STEP
    return {"mean colors": found}


def mean_color(path: Path) -> list[float]:
    """Of the opaque pixels of a picture, as displayed, in [0, 1]."""
    image = bpy.data.images.load(str(path))
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    pixels = pixels.reshape(-1, 4)
    return pixels[pixels[:, 3] > 0.99, :3].mean(axis=0).tolist()


def pictures(watch: Watch) -> Scenario:
    """The panel idle, running, failed and done; nothing is measured here."""
    shoot("idle")
    yield 0.5
    yield from click_generate()
    yield 2.5
    shoot("running")
    while module("generate.operators").is_running():
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


def doubtful(watch: Watch) -> Scenario:
    """A result of views one of which has a wrong camera: the panel says that it is doubtful, and why."""
    views = OUT / "moved"
    shutil.copytree(VIEWS, views, dirs_exist_ok=True)
    data = json.loads(Path(VIEWS, "transforms.json").read_text())
    data["frames"][2]["transform_matrix"][2][3] += MOVED
    (views / "transforms.json").write_text(json.dumps(data))
    yield from choose_views(str(views))
    job = yield from begin_run()
    while module("generate.operators").is_running():
        yield 0.2
    assert job.result is not None, state().error
    yield SETTLED
    shoot("doubtful")
    said = json.loads(window().view_layer.objects.active["arm_settings"])["report"]["doubts"]
    return {"doubts": said}


def click_generate() -> Scenario:
    """Press the panel's button with the mouse; the job that it starts."""
    ready = module("generate.operators")
    yield from click("generate")
    for _ in range(200):
        if ready.is_running():
            return ready._running
        yield STEP
    shoot("no-button")
    raise AssertionError(f"no run begins by a click: {state().error}; see no-button.png")


def generated() -> Scenario:
    """A result, by the panel's button."""
    yield from click_generate()
    while module("generate.operators").is_running():
        yield STEP


def begin_run() -> Scenario:
    """A run that is at work in its networks."""
    if not bpy.context.scene.arm.views_path:
        yield from choose_views()
    with in_view():
        bpy.ops.arm.generate("INVOKE_DEFAULT")
    yield 2.0
    assert module("generate.operators").is_running(), state().error
    return module("generate.operators")._running


def choose_views(views: str = VIEWS) -> Scenario:
    settings = bpy.context.scene.arm
    settings.quality, settings.views_path = "draft", views
    yield 0.3
    while module("input.view_list").is_looking():
        yield 0.1


def prepare(watch: Watch, chosen: bool) -> Scenario:
    """The extension enabled, its tab in front; where views are to be chosen the cube gives way."""
    addon_utils.enable(EXTENSION, default_set=True)
    watch.attach()
    area().spaces.active.show_region_ui = True
    yield 0.5
    next(region for region in area().regions if region.type == "UI").active_panel_category = "ARM"
    if chosen:
        bpy.data.objects.remove(bpy.data.objects["Cube"])
        yield from choose_views()
    yield 0.5


SCENARIOS = {
    "pictures": pictures,
    "example": lambda watch: example(generated()),
    "run": run,
    "cancel": cancel,
    "load": load,
    "quit": leave,
    "disable": disable,
    "engines": engines,
    "photographs": photographs,
    "doubtful": doubtful,
    "materials": lambda watch: materials(watch, generated()),
}


def whole(name: str) -> Scenario:
    watch = Watch()
    yield from prepare(watch, chosen=name != "example")
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
