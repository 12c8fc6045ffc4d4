"""Stopping inside a network: on a CPU one pass of a large one takes longer than anybody waits for a stop."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from torch import nn


@contextmanager
def interruptible(networks: Iterable[nn.Module], check: Callable[[], None]) -> Iterator[None]:
    """Calls `check` before every module of `networks` runs, down to single layers; what it raises ends the pass there.

    The networks are left without hooks, however the block ends.
    """

    def before(module: nn.Module, args: object) -> None:
        check()

    # A dictionary keeps the order, and each module once.
    modules = dict.fromkeys(module for network in networks for module in network.modules())
    handles = [module.register_forward_pre_hook(before) for module in modules]
    try:
        yield
    finally:
        for handle in handles:
            handle.remove()
