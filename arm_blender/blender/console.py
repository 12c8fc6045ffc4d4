"""Blender prints to the standard output while it works; there the command line's results go, and nothing else may."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from ..machine.quiet import STDOUT, silenced


@contextmanager
def without_chatter() -> Iterator[None]:
    """Drops what Blender prints during the block, or the decorated function; errors are raised, so none is lost.

    With a window nothing is dropped: there the standard output is Blender's own console.
    """
    if not bpy.app.background:
        yield
        return
    with silenced(STDOUT):
        yield
