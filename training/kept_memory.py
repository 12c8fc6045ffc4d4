"""How much a forward pass keeps for the gradient: the activations that a device has to hold."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from .blocks import repeated


class Kept:
    """Storages that a forward pass keeps, weights apart; also of tensors on the meta device, which are not there."""

    def __init__(self) -> None:
        self._kept: dict[int, Tensor] = {}
        self._weights: set[int] = set()

    @property
    def bytes(self) -> int:
        """Of all that is kept so far."""
        return sum(x.untyped_storage().nbytes() for key, x in self._kept.items() if key not in self._weights)

    def add(self, x: Tensor) -> Tensor:
        """Count a tensor, once a storage."""
        self._kept[_storage(x)] = x  # Held, so that no other storage takes its name.
        return x


def _storage(x: Tensor) -> int:
    return x.untyped_storage()._cdata


@contextmanager
def kept_by(model: nn.Module) -> Iterator[Kept]:
    """Counts what forward passes inside the block keep; read it before the gradient is computed.

    Blocks that run again for the gradient keep their inputs, which autograd does not know of: they count as well.
    """
    found = Kept()
    found._weights = {_storage(parameter) for parameter in model.parameters()}

    def input_of(module: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        if torch.is_grad_enabled():
            for x in inputs:
                found.add(x)

    hooks = [block.register_forward_pre_hook(input_of) for block in repeated(model)]
    try:
        with torch.autograd.graph.saved_tensors_hooks(found.add, lambda x: x):
            yield found
    finally:
        for hook in hooks:
            hook.remove()
