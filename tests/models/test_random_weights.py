"""Random weights: the same for a seed, neither fading nor growing, and with a surface whatever the field."""

import pytest
import torch
from torch import nn

from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, extract
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.random_weights import DENTS, RADIUS, dented_ball, random_state

from .paper.test_reconstruction import TINY


def test_a_seed_is_one_state_and_leaves_the_callers_random_numbers():
    with torch.device("meta"):
        module = GeoRM(TINY)
    before = torch.get_rng_state()
    first, again, other = (random_state(module, seed) for seed in (3, 3, 4))
    assert torch.equal(torch.get_rng_state(), before)
    assert first.keys() == module.state_dict().keys()
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert any(not torch.equal(first[key], other[key]) for key in first)


def test_glossyrm_begins_with_what_georm_has():
    with torch.device("meta"):
        modules = GeoRM(TINY), GlossyRM(TINY)
    states = [random_state(module, 0) for module in modules]
    last = [key for key in states[0] if states[0][key].shape != states[1][key].shape]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0] if key.startswith("model.transformer"))
    assert last and all(states[1][key].shape[0] == 2 for key in last)


@pytest.mark.parametrize("module", [nn.Linear(512, 256), nn.Conv2d(64, 32, 3, padding=1, padding_mode="circular")])
def test_what_goes_through_keeps_its_variance(module):
    module.load_state_dict(random_state(module, 0))
    shape = (256, 512) if isinstance(module, nn.Linear) else (4, 64, 32, 32)
    out = module(torch.randn(shape, generator=torch.Generator().manual_seed(1)))
    assert float(out.detach().std()) == pytest.approx(1.0, rel=0.1)


def waves(points: torch.Tensor) -> torch.Tensor:
    return 1e-6 * torch.sin(5.0 * points).sum(dim=1) + 3.0


@pytest.mark.parametrize("field", [waves, lambda points: torch.full((len(points),), 7.0)], ids=["waves", "constant"])
def test_any_field_dents_a_ball(field):
    surface = extract(dented_ball(field, 1000, "cpu"), IsosurfaceConfig(48, iso=0.0))
    away = surface.vertices.norm(dim=1) - RADIUS
    assert float(away.abs().max()) < 4.0 * DENTS
    edges = surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).sort(dim=1).values
    assert bool((edges.unique(dim=0, return_counts=True)[1] == 2).all())
    # A constant field leaves the ball: what is off is the grid's straight edges.
    assert (float(away.std()) > 0.3 * DENTS) is (field is waves)
