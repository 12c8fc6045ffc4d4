"""Memory that does not suffice becomes an error that names the setting to lower; child processes get no more."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from ..errors import OutOfMemory

_ALLOCATORS = ("DefaultCPUAllocator", "not enough memory", "out of memory")
"""What the messages of torch's allocators hold: for the CPU, for it on Windows, for CUDA and Apple's devices."""


@contextmanager
def lower_if_short(stage: str, remedy: str) -> Iterator[None]:
    """Turns the out-of-memory errors of the block into one of ours.

    Args:
        stage: what the memory was for.
        remedy: what takes less.
    Raises:
        OutOfMemory: the memory of the machine or of its device does not suffice.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and not any(part in str(error) for part in _ALLOCATORS):
            raise
        raise OutOfMemory(f"{stage}: the memory does not suffice; {remedy}") from error


def limit_child(process: int, most: int | None = None) -> None:
    """Lets a child process take no more memory than that, where the system can say so (Linux).

    It then fails by itself, as when it crashes, instead of driving everything else out.

    Args:
        process: its number; a child that has ended is left alone.
        most: bytes of its address space; None for twice what the machine has, since not all of it is used.
    """
    try:
        import resource

        change = resource.prlimit
        machine = 2 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ImportError, AttributeError, ValueError, OSError):  # Windows, macOS.
        return
    most = machine if most is None else min(most, machine)
    with suppress(OSError, ValueError):  # It has ended, or was given less.
        change(process, resource.RLIMIT_AS, (most, most))
