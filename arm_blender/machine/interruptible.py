"""Stopping inside a network: on a CPU one pass of a large one takes longer than anybody waits for a stop."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from torch import nn


def blocks(network: nn.Module) -> list[nn.Module]:
    """The network and all that it keeps in lists and sequences: stages, their residual blocks, attentions, layers."""
    found = {network: None}  # A dictionary keeps the order, and each block once.
    for module in network.modules():
        if isinstance(module, nn.ModuleList | nn.Sequential):
            found |= dict.fromkeys(module)
    return list(found)


@contextmanager
def interruptible(networks: Iterable[nn.Module], check: Callable[[], None]) -> Iterator[None]:
    """Calls `check` before every block of `networks` runs; what it raises ends the pass there.

    The networks are left without hooks, however the block ends.
    """

    def before(block: nn.Module, args: object) -> None:
        check()

    handles = [block.register_forward_pre_hook(before) for network in networks for block in blocks(network)]
    try:
        yield
    finally:
        for handle in handles:
            handle.remove()
