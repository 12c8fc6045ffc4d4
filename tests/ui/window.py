"""The window that scenarios act in: where it is, what the extension knows, and pictures of it. Inside Blender."""

import importlib
import subprocess
from pathlib import Path

import bpy

EXTENSION = "bl_ext.user_default.arm_blender"
OUT, PROJECT = Path("/mnt/out"), Path("/mnt/project")


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
