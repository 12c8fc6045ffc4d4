"""Libraries of C print by themselves; what they print can be kept off a stream for a while."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

STDOUT, STDERR = 1, 2


@contextmanager
def silenced(descriptor: int) -> Iterator[None]:
    """Drops what is written to a stream during the block, by Python and by C.

    Args:
        descriptor: `STDOUT` or `STDERR`, of the whole process: other threads are silenced as well.
    """
    _flush()
    kept = os.dup(descriptor)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)
    try:
        yield
    finally:
        _flush()  # What still waits in a buffer would come out after the block.
        os.dup2(kept, descriptor)
        os.close(kept)


def _flush() -> None:
    """Empty Python's and C's buffers."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).fflush(None)
