"""Every tensor and every input column of what ships has a say in what its network answers.

Weights that none of a network's answers depends on would be carried along, loaded and run for nothing.
"""

from pathlib import Path

import pytest
import torch
import trimesh
from torch import Tensor, nn
from torch.nn import functional

from arm_blender import networks
from arm_blender.config import Settings
from arm_blender.models.network_views import network_views
from arm_blender.models.small.finish import COUNT, Finish, summary
from arm_blender.structures import TriangleMesh, ViewSet
from arm_blender.uv.backproject import backproject
from arm_blender.uv.blend import blend
from arm_blender.uv.maps import diffuse_fill
from arm_blender.uv.texels import texel_map
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views import load_views
from arm_blender.views.scene_frame import normalise

EXAMPLE = Path(__file__).parents[2] / "arm_blender" / "examples" / "barrel"
INPUT_AXIS = {nn.Linear: 1, nn.Conv2d: 1, nn.Conv3d: 1, nn.ConvTranspose2d: 0}
"""The dimension of their weights that runs over what they read."""


@pytest.fixture(scope="module")
def inputs() -> list[ViewSet]:
    """Six views of an object, one, and one of the object lying down, so that no camera is upright."""
    views = normalise(load_views(EXAMPLE))[0]
    tilt = torch.eye(4)
    tilt[1:3, 1:3] = torch.tensor([[0.8, -0.6], [0.6, 0.8]])
    one = views.only([0])
    (camera,) = one.cameras
    tilted = type(camera)(tilt @ camera.c2w, camera.K, camera.width, camera.height)
    return [views, one, ViewSet(one.images, (tilted,), one.weights, one.name)]


@pytest.fixture(autouse=True)
def no_sleeping_units(monkeypatch):
    """A unit that is 0 for this object may wake for another; what is looked for is what no object can wake."""
    gelu = functional.gelu
    monkeypatch.setattr(functional, "relu", lambda x, inplace=False: functional.leaky_relu(x, 0.1))
    monkeypatch.setattr(functional, "gelu", lambda x, approximate="none": gelu(x, approximate=approximate) + 0.1 * x)


def at_points(network: nn.Module, views: ViewSet) -> Tensor:
    """Logits, or roughness and metallic, at points of the box."""
    points = 2.0 * torch.rand(1, 4096, 3, generator=torch.Generator().manual_seed(0)) - 1.0
    encoded = network.encode(network_views(views, network.config))
    return network.occupancy_logit(encoded, points) if hasattr(network, "occupancy_logit") else network(encoded, points)


def on_atlas(network: nn.Module, views: ViewSet) -> Tensor:
    """Albedo and baked colour over a ball on which the views lie, and what delighting says where they see it."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.7)
    mesh, _ = unwrap(
        TriangleMesh(torch.tensor(ball.vertices).float(), torch.tensor(ball.faces)), UnwrapConfig(256, time_limit=0.0)
    )
    texels = texel_map(mesh, 192)
    seen = backproject(mesh, texels, views)
    colors, weight = blend(seen, views.weights)
    base = diffuse_fill(colors, (weight > 0.0) & texels.mask, texels)
    read, log_gain = [], network.delighting.log_gain
    network.delighting.log_gain = lambda points: read.append(points) or log_gain(points)
    colors = torch.cat(network(views.images, texels, seen, base))[:, texels.mask]
    # In the network itself this is no part of the gradient: a stage of its own learns it.
    return torch.cat([colors.flatten(), log_gain(*read)[0].flatten()])


def of_evidence(network: Finish, _: ViewSet) -> Tensor:
    """What both read-outs say of evidence about as usual, and of any score of metal: a ceiling is for high ones."""
    generator, answers = torch.Generator().manual_seed(0), []
    for readout in (network.several, network.few):
        deviations = torch.randn(256, COUNT, generator=generator)
        found = readout.point.mean + deviations / readout.point.scale
        answer, _ = network.answer(readout, found.detach(), summary(found.detach()))
        answers += [answer.flatten(), readout.metal(torch.linspace(-50.0, 50.0, 101))]
    return torch.cat(answers)


ANSWERS = {"instant_albedo": on_atlas, "finish": of_evidence}
"""Of a network; `at_points` of any other."""


def silent(network: nn.Module, gradients: dict[str, Tensor]) -> list[str]:
    """Names of tensors without any gradient, and of weights whose input columns have none, with those."""
    found = []
    for name, module in network.named_modules():
        for own, _ in module.named_parameters(recurse=False):
            path = f"{name}.{own}".lstrip(".")
            gradient = gradients[path]
            if not gradient.any():
                found.append(path)
            elif own == "weight" and type(module) in INPUT_AXIS:
                columns = gradient.movedim(INPUT_AXIS[type(module)], 0).flatten(1)
                idle = (columns == 0.0).all(dim=1).nonzero()[:, 0].tolist()
                found += [f"{path}, columns {idle}"] if idle else []
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", Settings().networks)
def test_what_ships_has_no_weight_without_a_say(name, inputs):
    network = networks.read(name, Settings().weights(name))
    gradients = {path: torch.zeros_like(parameter) for path, parameter in network.named_parameters()}
    for views in inputs:
        network.zero_grad()
        answers = ANSWERS.get(name, at_points)(network, views)
        # At random signs, so that nothing cancels.
        (answers * torch.randn(answers.shape, generator=torch.Generator().manual_seed(1))).sum().backward()
        for path, parameter in network.named_parameters():
            gradients[path] += 0.0 if parameter.grad is None else parameter.grad.abs()
    assert silent(network, gradients) == []


def test_a_column_of_zeros_is_found_by_what_it_hides():
    """The input of a network that multiplies one of its features by 0, and a part that nothing reads."""
    network = nn.Sequential(nn.Linear(3, 2), nn.Linear(2, 1, bias=False))
    with torch.no_grad():
        network[1].weight[:, 0] = 0.0
    inputs = torch.rand(5, 3) * torch.tensor([1.0, 1.0, 0.0])
    network(inputs).sum().backward()
    network.spare = nn.Linear(1, 1)
    gradients = {n: torch.zeros_like(p) if p.grad is None else p.grad for n, p in network.named_parameters()}
    assert silent(network, gradients) == ["0.weight, columns [2]", "spare.weight", "spare.bias"]
