"""What a new user does: two clicks from nothing to a result. Runs inside Blender."""

import time
from collections.abc import Iterator
from pathlib import Path

import bpy
from window import click, in_view, module, shoot, state

SETTLED = 5.0
"""Seconds until the 3D view is drawn with a new object in it."""


def example(generated: Iterator[float]) -> Iterator[float]:
    """Blender as it starts, its cube included: a click on Example, one on Generate, nothing else; then both undone.

    Args:
        generated: clicks Generate, and goes on when the result is there.
    """
    shoot("example-nothing")
    yield from click("example")
    yield 0.3
    while module("input.view_list").is_looking():
        yield 0.1
    settings = bpy.context.scene.arm
    result = {"path": Path(settings.views_path).name, "views": len(settings.views), "kind": settings.views_kind}
    before = set(bpy.data.objects.keys())
    began = time.perf_counter()
    yield from generated
    result |= {"seconds": time.perf_counter() - began, "error": state().error, "hidden by": state().hidden_by}
    result["made"] = len(set(bpy.data.objects.keys()) - before)
    yield SETTLED
    shoot("example-made")
    for _ in range(2):
        with in_view():
            bpy.ops.ed.undo()
        yield 0.5
    return result | {"path after two undos": bpy.context.scene.arm.views_path}
