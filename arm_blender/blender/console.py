"""Blender prints to the standard output while it works; there the command line's results go, and nothing else may."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def without_chatter() -> Iterator[None]:
    """Drops what Blender prints during the block, or the decorated function; errors are raised, so none is lost.

    With a window nothing is dropped: there the standard output is Blender's own console.
    """
    if not bpy.app.background:
        yield
        return
    _flush()
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    try:
        yield
    finally:
        _flush()  # What still waits in a buffer would come out after the block.
        os.dup2(kept, 1)
        os.close(kept)


def _flush() -> None:
    """Empty Python's and C's buffers of the standard output."""
    if sys.stdout is not None:
        sys.stdout.flush()
    ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).fflush(None)
