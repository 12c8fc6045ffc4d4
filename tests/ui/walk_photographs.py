"""Photographs in a window, from the file browser to the asset: chosen, solved, looked at, a mask painted, generated.

Runs inside Blender. The photographs are of a made-up still life (tests/photographs/cameras/scenes.py); their alpha is
the true mask, so that only what is asked here can fail.
"""

import importlib.util
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import bpy
import numpy as np
from PIL import Image
from watch import Watch
from window import OUT, PROJECT, in_view, module, shoot, state

COUNT = 12
"""Photographs that are made."""
STEP = 0.05
"""Seconds between two looks for an event."""


def photographs(watch: Watch) -> Iterator[float]:
    folder = write_photographs(OUT / "still-life")
    browser = yield from choose(folder)
    settings = bpy.context.scene.arm
    yield from until_looked()
    found = {"browser": browser, "listed": len(settings.views), "kind": settings.views_kind}
    shoot("photographs-listed")
    began = time.perf_counter()
    with in_view():
        bpy.ops.arm.solve_cameras("INVOKE_DEFAULT")
    yield from until_done()
    found |= {"seconds": time.perf_counter() - began, "error": state().error}
    assert not found["error"], found["error"]
    yield from until_looked()
    shoot("photographs-solved")
    views = Path(settings.views_path)
    found["cameras"] = sum(item.type == "CAMERA" and "IMG" in item.name for item in bpy.data.objects)
    found["ground"] = "ARM ground" in bpy.data.objects
    found["rows"] = [(row.name, row.view, row.short) for row in settings.photographs]
    found |= yield from edit_mask(views, next(row.view for row in settings.photographs if row.view))
    settings.views_path, settings.quality = str(folder), "draft"
    yield from until_looked()
    before = set(bpy.data.objects.keys())
    with in_view():
        bpy.ops.arm.generate("INVOKE_DEFAULT")
    yield from until_done()
    yield from until_looked()
    yield 5.0
    shoot("photographs-done")
    found |= {"error": state().error, "made": len(set(bpy.data.objects.keys()) - before)}
    found["rows after"] = [(row.name, row.view, row.short) for row in settings.photographs]
    return found


def write_photographs(folder: Path) -> Path:
    """Pictures with alpha in a new folder."""
    scenes = still_life()
    folder.mkdir(exist_ok=True)
    for index, c2w in enumerate(scenes.ring(COUNT)):
        picture, mask = scenes.photograph(scenes.StillLife(), c2w)
        alpha = (mask * 255).astype(np.uint8)[..., None]
        Image.fromarray(np.concatenate([picture, alpha], axis=-1)).save(folder / f"IMG_{index:04d}.png")
    return folder


def still_life() -> ModuleType:
    """The module by its file: `tests` is no package of Blender's."""
    path = PROJECT / "tests" / "photographs" / "cameras" / "scenes.py"
    spec = importlib.util.spec_from_file_location("scenes", path)
    made = importlib.util.module_from_spec(spec)
    sys.modules["scenes"] = made
    spec.loader.exec_module(made)
    return made


def choose(folder: Path) -> Iterator[float]:
    """Open the file browser by *Photographs...*, choose all files of a folder, accept; whether that did it."""
    bpy.context.preferences.view.filebrowser_display_type = "WINDOW"
    with in_view():
        bpy.ops.arm.choose_photographs("INVOKE_DEFAULT")
    yield 1.0
    windows = bpy.context.window_manager.windows
    browsers = [(one, area) for one in windows for area in one.screen.areas if area.type == "FILE_BROWSER"]
    if browsers:
        one, area = browsers[0]
        area.spaces.active.params.directory = f"{folder}/".encode()
        yield 3.0
        region = next(region for region in area.regions if region.type == "WINDOW")
        with bpy.context.temp_override(window=one, area=area, region=region):
            bpy.ops.file.select_all(action="SELECT")
        yield 0.5
        shoot("photographs-browser")
        with bpy.context.temp_override(window=one, area=area, region=region), suppress(RuntimeError):
            bpy.ops.file.execute()
        yield 1.0
    chosen = Path(bpy.context.scene.arm.views_path) == folder
    if not chosen:
        with in_view():
            bpy.ops.arm.choose_photographs(directory=f"{folder}/")
    return chosen


def edit_mask(views: Path, name: str) -> Iterator[float]:
    """Open the mask of a view, paint half of it black, use it; what was seen of that."""
    settings, windows = bpy.context.scene.arm, bpy.context.window_manager.windows
    with in_view():
        bpy.ops.arm.edit_mask("INVOKE_DEFAULT", picture=str(views / name), root=str(views))
    yield from until_done()
    yield 1.5
    editors = [area for one in windows for area in one.screen.areas if area.type == "IMAGE_EDITOR"]
    modes = sorted(area.spaces.active.mode for area in editors)
    (mask,) = [image for image in bpy.data.images if "arm_mask_of" in image]
    pixels = np.empty(len(mask.pixels), np.float32)
    mask.pixels.foreach_get(pixels)
    pixels = pixels.reshape(mask.size[1], mask.size[0], 4)
    pixels[:, : mask.size[0] // 2, :3] = 0.0
    mask.pixels.foreach_set(pixels.ravel())
    mask.update()
    yield 1.0
    shoot("photographs-mask")
    painted = mask.is_dirty
    with in_view():
        bpy.ops.arm.use_masks()
    yield from until_looked()
    with bpy.context.temp_override(window=windows[-1]):
        bpy.ops.wm.window_close()
    told = next(row.short for row in settings.photographs if row.view == name)
    return {"editors": modes, "painted": painted and not mask.is_dirty, "told": told}


def until_done() -> Iterator[float]:
    yield STEP
    while module("generate.operators").is_running():
        yield STEP


def until_looked() -> Iterator[float]:
    yield 0.3
    while module("input.view_list").is_looking():
        yield STEP
    yield 0.5
