"""Memory that does not suffice becomes an error that names the setting to lower."""

from collections.abc import Iterator
from contextlib import contextmanager

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
