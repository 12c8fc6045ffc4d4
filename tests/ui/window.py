"""The window that scenarios act in: where it is, what the extension knows, and pictures of it. Inside Blender."""

import importlib
import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import bpy

EXTENSION = "bl_ext.user_default.arm_blender"
OUT, PROJECT = Path("/mnt/out"), Path("/mnt/project")
ESC_AT = 400, 400
"""A pixel of the 3D view, where no button is."""


def module(name: str):
    return importlib.import_module(f"{EXTENSION}.arm_blender.blender.{name}")


def window() -> bpy.types.Window:
    return bpy.context.window_manager.windows[0]


def area() -> bpy.types.Area:
    return next(area for area in window().screen.areas if area.type == "VIEW_3D")


def in_view():
    region = next(region for region in area().regions if region.type == "WINDOW")
    return bpy.context.temp_override(window=window(), area=area(), region=region)


def state():
    return bpy.context.window_manager.arm


def shoot(name: str) -> None:
    subprocess.run(["import", "-window", "root", OUT / f"{name}.png"], check=True)


def click(button: str) -> Iterator[float]:
    """Press a button of the panel with the mouse."""
    x, y = json.loads(os.environ["ARM_BUTTONS"])[button]
    for aside in (40, 2, 0):  # The first move finds the sidebar, the next its button.
        window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x + aside, y=y)
        yield 0.2
    for value in ("PRESS", "RELEASE"):
        window().event_simulate(type="LEFTMOUSE", value=value, x=x, y=y)
        yield 0.1
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=ESC_AT[0], y=ESC_AT[1])
