"""GlossyRM on GeoRM's shape: what is rendered is what the vertices have, and the paper's loss falls."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import ReconstructionConfig
from arm_blender.models.small.volume_georm import VolumeGeoRM, VolumeGeoRMConfig
from arm_blender.models.triplane import DecoderConfig
from arm_blender.weight_files import checkpoints
from training import __main__ as command
from training.datasets import gloss_samples, view_samples
from training.datasets.gloss_samples import GlossSample, Shapes
from training.rendering import shards
from training.stages import glossyrm, rendered_views
from training.stages.glossyrm import GlossyConfig, rendered, sample_loss, validation_terms
from training.stages.rendered_views import TINY

pytestmark = pytest.mark.usefixtures("one_thread")

FEW = GlossyConfig(grid=24, side=32, views=4)


@pytest.fixture
def georm(tmp_path) -> Path:
    """Weights of a GeoRM that has learnt nothing."""
    torch.manual_seed(0)
    path = tmp_path / "georm.safetensors"
    checkpoints.save(path, GeoRM(TINY).state_dict(), TINY, "tiny.georm")
    return path


@pytest.fixture
def sample(ball_shards, plane_network) -> GlossSample:
    """A ball whose upper half is metal; its shape is the true one."""
    path = ball_shards / "one" / "rig_0.npz"
    plain, mesh = view_samples.load(path, plane_network), shards.read_mesh(path.with_name("mesh.npz"))
    maps = np.load(path)
    gloss = torch.stack([torch.from_numpy(maps[name]).float() / 255.0 for name in ("roughness", "metallic")], dim=1)
    return GlossSample(plain.inputs, plain.c2w, plain.K, plain.truth, mesh.vertices, mesh.faces, gloss)


class Halves(torch.nn.Module):
    """Takes the place of a network that knows the object: metal above a height, and a roughness."""

    def __init__(self, roughness: float, height: float = 0.0) -> None:
        super().__init__()
        self.roughness, self.height = torch.nn.Parameter(torch.tensor(roughness)), height

    def encode(self, views) -> "Halves":
        return self

    def float(self) -> "Halves":
        return self

    def forward(self, encoded, points: torch.Tensor) -> torch.Tensor:
        metal = ((points[..., 2] - self.height) * 20.0).sigmoid()
        return torch.stack([self.roughness.expand_as(metal), metal], dim=-1)


def test_the_truth_costs_almost_nothing_and_each_error_its_own_term(sample):
    def cost(model: Halves) -> dict[str, float]:
        draws = torch.Generator().manual_seed(0)
        return {name: float(term.detach()) for name, term in sample_loss(model, sample, FEW, draws).items()}

    # Between metal and none lies a face of the icosphere: a tenth of the error of a wrong border.
    true, rough, high = cost(Halves(60 / 255)), cost(Halves(0.8)), cost(Halves(60 / 255, 0.25))
    assert true["roughness"] < 1e-4 and true["metallic"] < 0.08
    # Squared error by its weight and the structure of constants: luminance alone differs.
    a, b = 0.8, 60 / 255
    luminance = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)
    assert rough["roughness"] == pytest.approx(0.7 * (a - b) ** 2 + 0.1 * (1 - luminance), rel=0.1)
    assert rough["metallic"] == pytest.approx(true["metallic"])
    assert high["metallic"] > 2.0 * true["metallic"] and high["roughness"] == pytest.approx(true["roughness"])


@pytest.mark.parametrize("roughness", [0.0, 1.0])
def test_gradients_are_finite_at_the_ends_of_the_range(sample, roughness):
    model = Halves(roughness)
    sum(sample_loss(model, sample, FEW, torch.Generator().manual_seed(0)).values()).backward()
    assert bool(model.roughness.grad.isfinite()) and float(model.roughness.grad) * (roughness - 0.5) > 0.0


@torch.no_grad()
def test_moving_an_object_changes_nothing_that_is_compared(sample):
    draws = torch.Generator().manual_seed(5)
    moved = view_samples.moved(sample, draws)
    assert not torch.equal(moved.vertices, sample.vertices)
    every, model = torch.arange(10), Halves(0.5, 0.0)
    found, again = (rendered(model, model, s, every, 32) for s in (sample, moved))
    assert torch.equal(found[1], again[1]) and float((found[2] ^ again[2]).float().mean()) < 0.01
    both = (found[2] & again[2])[:, None]
    assert float(((found[0] - again[0]) * both).abs().mean()) < 0.01


@pytest.mark.parametrize("lost", ["surface", "views"])
def test_without_anything_to_compare_the_loss_is_zero_with_a_finite_gradient(sample, plane_network, lost):
    torch.manual_seed(0)
    model = GlossyRM(plane_network)
    if lost == "surface":
        sample = replace(sample, vertices=torch.zeros(0, 3), faces=torch.zeros(0, 3, dtype=torch.int64))
    else:
        sample = replace(sample, truth=replace(sample.truth, mask=torch.zeros_like(sample.truth.mask)))
    moved = view_samples.moved(sample, torch.Generator().manual_seed(0))
    loss = sum(sample_loss(model, moved, FEW, torch.Generator().manual_seed(0)).values())
    loss.backward()
    assert float(loss.detach()) == 0.0
    assert all(bool(p.grad.isfinite().all()) for p in model.parameters() if p.grad is not None)
    errors = validation_terms(model, sample, FEW, torch.Generator().manual_seed(0))
    assert all(float(value) == 0.0 for value in errors.values())


def test_one_object_is_learnt(sample, plane_network):
    """The paper's modules at a test's size."""
    torch.manual_seed(0)
    model, draws = GlossyRM(plane_network), torch.Generator().manual_seed(0)
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)

    def errors() -> tuple[float, float]:
        found = validation_terms(model, sample, FEW, torch.Generator().manual_seed(0))
        return float(found["roughness error"]), float(found["metallic error"])

    before = errors()
    for _ in range(60):
        optimizer.zero_grad()
        sum(sample_loss(model, sample, FEW, draws).values()).backward()
        optimizer.step()
    assert all(new < 0.4 * old for new, old in zip(errors(), before, strict=True))


def test_shapes_are_kept_for_the_weights_that_made_them(ball_shards, tmp_path, monkeypatch, plane_network):
    path, georm = ball_shards / "one" / "rig_0.npz", tmp_path / "volumes.safetensors"
    network = VolumeGeoRM(VolumeGeoRMConfig())
    for layer in (network.decoder[-1], network.coarse_vote, network.detail_vote):  # Its shape is the visual hull.
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
    checkpoints.save(georm, network.state_dict(), network.config, "small.georm")
    shapes = Shapes(georm, 24, torch.device("cpu"), tmp_path / "shapes")
    first = shapes.load(path, plane_network)
    radius = first.vertices.norm(dim=1)
    assert float(radius.min()) > 0.5 and float(radius.max()) < 0.9  # The hull of a ball of 0.6.
    monkeypatch.setattr(gloss_samples, "extract", None)
    again = shapes.load(path, plane_network)
    assert torch.equal(first.vertices, again.vertices) and torch.equal(first.faces, again.faces)
    with pytest.raises(TypeError):  # Another grid: made anew.
        Shapes(georm, 25, torch.device("cpu"), tmp_path / "shapes").load(path, plane_network)


def test_a_fit_starts_from_georm_and_leaves_weights_and_a_picture(ball_shards, georm, tmp_path, monkeypatch):
    monkeypatch.setattr(rendered_views, "is_held_out", lambda path: path.parent.name == "three")
    monkeypatch.setattr(glossyrm, "TINY_GLOSSY", FEW)
    output = tmp_path / "glossyrm.safetensors"
    words = ["fit", "glossyrm", "--shards", str(ball_shards), "--georm", str(georm), "--output", str(output)]
    assert command.main([*words, "--steps", "2", "--shapes", str(tmp_path / "shapes")]) == 0
    config, state = checkpoints.load(output, ReconstructionConfig)
    assert config == TINY
    checkpoints.restore(GlossyRM(config), state, output)
    assert (tmp_path / "runs" / "glossyrm" / "validation.png").exists()
    assert len(list((tmp_path / "shapes").iterdir())) == 3


def test_the_georm_of_another_preset_is_refused_in_one_line(ball_shards, georm, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(glossyrm, "GlossyRM", lambda config: GlossyRM(replace(TINY, decoder=DecoderConfig(1, 8))))
    words = ["fit", "glossyrm", "--shards", str(ball_shards), "--georm", str(georm)]
    assert command.main([*words, "--output", str(tmp_path / "x.safetensors"), "--preset", "paper"]) == 1
    assert "georm.safetensors: its sizes are not those of the GlossyRM of --preset paper" in capsys.readouterr().err
