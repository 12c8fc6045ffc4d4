"""The first stage of GeoRM: what its windows show is true, its loss falls, and the paper's sizes take a step."""

from dataclasses import replace

import pytest
import torch

from arm_blender.models.network_views import NetworkViews
from arm_blender.models.paper.georm import RAW_ISO, GeoRM
from arm_blender.models.paper.reconstruction import PAPER, ReconstructionConfig
from arm_blender.weight_files import checkpoints
from training import __main__ as command
from training.datasets import view_samples
from training.datasets.view_samples import ViewSample
from training.losses import SurfaceMaps
from training.stages import georm_volume, rendered_views
from training.stages.georm_volume import VolumeConfig, rendering_loss, sample_loss
from training.stages.rendered_views import TINY
from training.volume_rendering import SamplingConfig

pytestmark = pytest.mark.usefixtures("one_thread")

FEW = VolumeConfig(SamplingConfig(coarse=12, fine=12), views=3, window=8, resolutions=(10, 16))
SIZE = 48
"""Pixels of a view of the balls."""


class Solid(torch.nn.Module):
    """Takes the place of a network that knows the object: a ball, whatever it is shown."""

    def __init__(self, radius: float, center: torch.Tensor) -> None:
        super().__init__()
        self.radius, self.center = radius, center

    def encode(self, views: NetworkViews) -> "Solid":
        return self

    def float(self) -> "Solid":
        return self

    def occupancy_logit(self, encoded: "Solid", points: torch.Tensor) -> torch.Tensor:
        return 3000.0 * (self.radius - (points - self.center).norm(dim=-1)) - RAW_ISO


def known(sample: ViewSample) -> Solid:
    """The ball of a sample, wherever it was moved, by its vertices."""
    center = sample.vertices.mean(dim=0)
    return Solid(float((sample.vertices - center).norm(dim=-1).max()), center)


@torch.no_grad()
@pytest.mark.parametrize("name", ["one", "two", "three"])
def test_the_truth_costs_almost_nothing_however_it_is_moved(shards, plane_network, name):
    """And a ball that is smaller, or elsewhere, costs more."""
    config, draws = VolumeConfig(SamplingConfig(64, 64), window=32, resolutions=(48, 48)), torch.Generator()
    sample = view_samples.moved(view_samples.load(shards / name / "rig_0.npz", plane_network), draws.manual_seed(3))
    assert float(sample.vertices.abs().max()) <= 1.0
    ball = known(sample)
    terms = sample_loss(ball, sample, config, draws.manual_seed(0))
    assert (
        float(terms["depth"]) < 0.5 * 2.0 / 63.0 and float(terms["mask"]) < 0.02 and float(terms["normal"]) < 0.2 * 0.05
    )
    shift = torch.tensor([0.1, 0.0, 0.0])
    for wrong in (Solid(0.8 * ball.radius, ball.center), Solid(ball.radius, ball.center + shift)):
        others = sample_loss(wrong, sample, config, draws.manual_seed(0))
        assert float(sum(others.values())) > 2.0 * float(sum(terms.values()))


def test_fifty_steps_lower_the_loss_on_fixed_data(shards, plane_network):
    """An object a step; the paper's modules at a test's size, which begin with a box that is full."""
    torch.manual_seed(0)
    network = plane_network
    model = GeoRM(network)
    samples = [view_samples.load(path, network) for path in sorted(shards.glob("*/rig_0.npz"))]

    def loss(sample: ViewSample) -> torch.Tensor:
        return sum(sample_loss(model, sample, FEW, torch.Generator().manual_seed(1)).values())

    def cost() -> float:
        with torch.no_grad():
            return float(sum(loss(sample) for sample in samples))

    optimizer, before = torch.optim.Adam(model.parameters(), 3e-3), cost()
    for step in range(50):
        optimizer.zero_grad()
        loss(samples[step % len(samples)]).backward()
        optimizer.step()
    assert cost() < 0.9 * before


def test_a_fit_leaves_weights_that_go_on_and_validates_what_it_never_saw(shards, tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(georm_volume, "TINY_VOLUME", FEW)
    first, second = tmp_path / "first.safetensors", tmp_path / "second.safetensors"
    words = ["fit", "georm-volume", "--shards", str(shards), "--minutes", "0.01", "--output"]
    with caplog.at_level("INFO"):
        assert command.main([*words, str(first)]) == 0
        assert command.main([*words, str(second), "--start", str(first), "--bfloat16"]) == 0
    assert "2 samples to train on, 1 held out" in caplog.text and "validation: depth" in caplog.text
    config, state = checkpoints.load(second, ReconstructionConfig)
    assert config == TINY
    checkpoints.restore(GeoRM(config), state, second)


def test_shards_that_only_validate_are_refused(shards, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(rendered_views, "is_held_out", lambda path: True)
    words = ["--shards", str(shards), "--output", str(tmp_path / "x.safetensors")]
    assert command.main(["fit", "georm-volume", *words]) == 1
    assert f"{shards}: all of its 3 samples only validate; render more objects" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words, limits", [(["0"], "1 to 48"), (["49"], "1 to 48"), (["16", "--feature-distance"], "32 to 48")]
)
def test_a_window_is_as_large_as_the_distance_needs_and_the_view_allows(shards, tmp_path, capsys, words, limits):
    output = ["--shards", str(shards), "--output", str(tmp_path / "x.safetensors")]
    assert command.main(["fit", "georm-volume", *output, "--window", *words]) == 1
    assert f"--window {words[0]}: give {limits}" in capsys.readouterr().err


def test_a_smaller_window_renders_fewer_rays(shards, tmp_path, monkeypatch):
    rendered, render = [], georm_volume.render
    monkeypatch.setattr(georm_volume, "TINY_VOLUME", replace(FEW, views=2))
    monkeypatch.setattr(
        georm_volume, "render", lambda field, rays, *more: rendered.append(rays) or render(field, rays, *more)
    )
    output = ["--shards", str(shards), "--output", str(tmp_path / "x.safetensors"), "--steps", "1"]
    assert command.main(["fit", "georm-volume", *output, "--window", "5"]) == 0
    assert rendered[0].origins.shape[1] == 2 * 5 * 5


@pytest.mark.parametrize("views", [6, 1])
def test_a_view_without_foreground_teaches_emptiness(shards, plane_network, views):
    """Nothing to see, depth at infinity: finite terms, and gradients that make the box emptier."""
    torch.manual_seed(0)
    model, sample = GeoRM(plane_network), view_samples.load(shards / "one" / "rig_0.npz", plane_network)
    nothing = SurfaceMaps(
        torch.zeros(10, SIZE, SIZE), torch.full((10, SIZE, SIZE), torch.inf), torch.zeros(10, 3, SIZE, SIZE)
    )
    empty = ViewSample(sample.inputs, sample.c2w, sample.K, nothing, sample.vertices)
    few = VolumeConfig(FEW.sampling, views=views, window=8, resolutions=(10, 10), fewer_views=1.0)
    terms = sample_loss(model, empty, few, torch.Generator().manual_seed(0))
    assert float(terms["depth"].detach()) == 0.0 == float(terms["normal"].detach()) < float(terms["mask"].detach())
    sum(terms.values()).backward()
    gradients = [p.grad for p in model.parameters() if p.grad is not None]
    assert all(bool(g.isfinite().all()) for g in gradients) and any(bool(g.any()) for g in gradients)


def test_a_step_at_the_papers_sizes_reaches_every_weight():
    """On the meta device, where nothing is computed: all shapes fit, and each parameter gets a gradient."""
    with torch.device("meta"):
        model = GeoRM(PAPER).to("meta")  # The images' mean and deviation are elsewhere by themselves.
        inputs = NetworkViews(
            torch.rand(1, 6, 4, 320, 320), torch.rand(1, 6, 2, 320, 320), torch.rand(1, 6, 4, 4), torch.rand(1, 6, 3, 3)
        )
        maps = SurfaceMaps(torch.rand(10, 512, 512), torch.rand(10, 512, 512), torch.rand(10, 3, 512, 512))
        sample = ViewSample(inputs, torch.rand(10, 4, 4), torch.rand(10, 3, 3), maps, torch.rand(4, 3))
    whole = VolumeConfig(SamplingConfig(rays_at_once=2**20))
    terms = rendering_loss(model, model.encode(inputs), sample, whole, torch.Generator())
    sum(terms.values()).backward()
    assert [name for name, p in model.named_parameters() if p.grad is None] == []
