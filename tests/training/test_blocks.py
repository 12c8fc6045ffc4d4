"""However blocks are run, the gradient is the same, and the weights keep their names."""

import pytest
import torch

from arm_blender.models.network_views import NetworkViews
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.reconstruction import PAPER
from training import blocks
from training.kept_memory import kept_by


def views() -> NetworkViews:
    draws = torch.Generator().manual_seed(1)
    shapes = ((1, 2, 4, 32, 32), (1, 2, 2, 32, 32), (1, 2, 4, 4), (1, 2, 3, 3))
    return NetworkViews(*(torch.rand(shape, generator=draws) for shape in shapes))


def gradients(model: GeoRM) -> dict[str, torch.Tensor]:
    points = torch.rand(1, 20, 3, generator=torch.Generator().manual_seed(2))
    model.zero_grad()
    model.occupancy_logit(model.encode(views()), points).square().mean().backward()
    return {name: parameter.grad.clone() for name, parameter in model.named_parameters()}


@pytest.fixture
def model(plane_network) -> GeoRM:
    torch.manual_seed(0)
    return GeoRM(plane_network)


def saved_bytes(model: GeoRM) -> int:
    with kept_by(model) as kept:
        model.encode(views())
    return kept.bytes


def test_what_is_kept_is_counted_once_and_without_weights():
    """In closed form: a product keeps its input and, for the next one's gradient, its output; a ReLU its output."""
    model = torch.nn.Sequential(torch.nn.Linear(8, 16), torch.nn.ReLU(), torch.nn.Linear(16, 4))
    for device in ("cpu", "meta"):
        model.to(device)
        with kept_by(model) as kept:
            model(torch.rand(10, 8, device=device))
        assert kept.bytes == 4 * 10 * (8 + 16)


def test_blocks_computed_again_give_the_same_gradient_and_keep_less(model):
    expected, kept = gradients(model), saved_bytes(model)
    names = list(model.state_dict())
    blocks.recompute(model)
    found = gradients(model)
    assert all(torch.equal(value, found[name]) for name, value in expected.items())
    assert saved_bytes(model) < 0.6 * kept  # Blocks' inputs are among it.
    assert list(model.state_dict()) == names


def test_compiled_blocks_give_the_same_gradient(model):
    expected = gradients(model)
    names = list(model.state_dict())
    # Traces and differentiates, and makes no machine code: that needs a compiler, and a minute.
    blocks.compile_blocks(model, "aot_eager")
    found = gradients(model)
    assert list(model.state_dict()) == names
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value, atol=1e-5, rtol=1e-4)


def test_the_papers_network_is_mostly_repeated_blocks():
    with torch.device("meta"):
        network = GeoRM(PAPER)
    found = blocks.repeated(network)
    assert len(found) == 12 + 16 + 4  # Layers of the encoder and of the transformer, residual blocks.
    inside = sum(parameter.numel() for block in found for parameter in block.parameters())
    assert inside > 0.9 * sum(parameter.numel() for parameter in network.parameters())
