"""A pass ends before the next layer, wherever in the network that is, and leaves no hook behind."""

import pytest
import torch
from torch import nn

from arm_blender.errors import Cancelled
from arm_blender.machine.interruptible import interruptible


class Residual(nn.Module):
    """Layers that stand in no list."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = nn.Linear(2, 2), nn.Linear(2, 2)
        self.ran: list[str] = []
        for name, layer in self.named_children():
            layer.register_forward_hook(lambda *_, name=name: self.ran.append(name))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + self.second(self.first(x))


def test_a_pass_ends_before_the_layer_at_which_the_check_raises():
    network, asked = Residual(), []

    def check() -> None:
        asked.append(None)
        if len(asked) == 3:  # The network itself, its first layer, its second.
            raise Cancelled("stopped by the user")

    with pytest.raises(Cancelled), interruptible((network,), check):
        network(torch.zeros(1, 2))
    assert network.ran == ["first"]
    network(torch.zeros(1, 2))
    assert len(asked) == 3, "a hook was left behind"


def test_a_layer_that_stands_in_two_networks_is_checked_once():
    shared = nn.Linear(2, 2)
    asked: list[None] = []
    with interruptible((nn.Sequential(shared), nn.Sequential(shared)), lambda: asked.append(None)):
        shared(torch.zeros(1, 2))
    assert len(asked) == 1
