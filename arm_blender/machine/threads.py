"""How many threads of the CPU torch takes, and where its random numbers begin."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def cpu_threads(count: int | None) -> Iterator[None]:
    """Inside the block torch uses `count` threads, or its own choice where that is None; the caller's come back."""
    before = torch.get_num_threads()
    if count is not None:
        torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def seeded_threads(count: int | None, seed: int) -> Iterator[None]:
    """As `cpu_threads`, with torch's random numbers of a seed; the caller's own come back."""
    random = torch.get_rng_state()
    with cpu_threads(count):
        torch.manual_seed(seed)
        try:
            yield
        finally:
            torch.set_rng_state(random)
