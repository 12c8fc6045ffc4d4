"""The second stage of GeoRM: what it renders is true, its loss falls, and without a surface one is pulled out."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.reconstruction import ReconstructionConfig
from arm_blender.weight_files import checkpoints
from training import __main__ as command
from training.datasets import view_samples
from training.datasets.view_samples import ViewSample
from training.losses import SurfaceMaps
from training.stages import georm_surface
from training.stages.georm_surface import SurfaceConfig, pull_towards_truth, sample_loss
from training.stages.rendered_views import TINY

pytestmark = pytest.mark.usefixtures("one_thread")

FEW = SurfaceConfig(grid=24, side=32, views=4, points=256)


class Solid(torch.nn.Module):
    """Takes the place of a network that knows the object: a ball, whatever it is shown."""

    def __init__(self, radius: float, center: Tensor) -> None:
        super().__init__()
        self.radius, self.center = torch.nn.Parameter(torch.tensor(radius)), center

    def encode(self, views) -> "Solid":
        return self

    def float(self) -> "Solid":
        return self

    def occupancy_logit(self, encoded: "Solid", points: Tensor) -> Tensor:
        return 100.0 * (self.radius - (points - self.center).norm(dim=-1))


def total(terms: dict[str, Tensor]) -> float:
    return float(sum(terms.values()).detach())


def known(sample: ViewSample) -> Solid:
    """The ball of a sample, wherever it was moved, by its vertices."""
    center = sample.vertices.mean(dim=0)
    return Solid(float((sample.vertices - center).norm(dim=-1).max()), center)


@pytest.mark.parametrize("name", ["one", "two", "three"])
def test_the_truth_costs_almost_nothing_however_it_is_moved(shards, plane_network, name):
    """And a ball that is smaller, or elsewhere, costs more; the gradient leads back."""
    draws = torch.Generator()
    sample = view_samples.moved(view_samples.load(shards / name / "rig_0.npz", plane_network), draws.manual_seed(3))
    config, ball = replace(FEW, grid=48, side=48), known(sample)
    cost = total(sample_loss(ball, sample, config, draws.manual_seed(0)))
    assert cost < 0.03
    for factor, sign in ((0.8, -1.0), (1.2, 1.0)):
        other = Solid(factor * float(ball.radius.detach()), ball.center)
        loss = sum(sample_loss(other, sample, config, draws.manual_seed(0)).values())
        loss.backward()
        assert float(loss.detach()) > 2.0 * cost and sign * float(other.radius.grad) > 0.0
    elsewhere = Solid(float(ball.radius.detach()), ball.center + torch.tensor([0.1, 0.0, 0.0]))
    assert total(sample_loss(elsewhere, sample, config, draws.manual_seed(0))) > 2.0 * cost


@pytest.mark.parametrize("offset", [-1e4, -30.0, 1e4], ids=["empty", "almost", "full"])
def test_without_a_surface_the_gradient_pulls_one_out(shards, plane_network, offset):
    """Solid behind the true surface, empty before it: by the signs of the density's own gradient."""
    sample = view_samples.load(shards / "one" / "rig_0.npz", plane_network)  # A ball of 0.6 in the middle.
    asked, raw = [], []

    def field(points: Tensor) -> Tensor:
        asked.append(points)
        raw.append((points[..., 0] * 0.0 + offset).requires_grad_())
        return raw[-1]

    whole = view_samples.crop(sample, torch.arange(10), 32, 32, torch.Generator().manual_seed(0))
    loss = pull_towards_truth(field, whole, FEW, torch.Generator().manual_seed(0))
    (gradient,) = torch.autograd.grad(loss, raw[-1])
    radius = asked[-1].norm(dim=-1)
    assert bool(gradient.isfinite().all()) and float(loss.detach()) == pytest.approx(abs(offset))
    if offset < 0:  # A step against the gradient fills the ball, a cell deep.
        assert bool((radius[gradient < 0.0] < 0.63).all()) and bool((gradient <= 0.0).all())
        assert int((gradient < 0.0).sum()) > 20
    else:
        assert bool((radius[gradient > 0.0] > 0.57).all()) and bool((gradient >= 0.0).all())


def test_one_object_is_learnt_from_a_box_without_a_surface(shards, plane_network):
    """The paper's modules at a test's size, from raw densities far below the iso value."""
    torch.manual_seed(0)
    network = plane_network
    model, sample = GeoRM(network), view_samples.load(shards / "one" / "rig_0.npz", network)
    with torch.no_grad():
        model.model.decoder[-1].bias -= 20.0
    optimizer, draws = torch.optim.Adam(model.parameters(), 3e-3), torch.Generator().manual_seed(0)
    seen, costs = set(), []
    for _ in range(80):
        terms = sample_loss(model, sample, FEW, draws)
        seen |= terms.keys()
        loss = sum(terms.values())
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        costs.append(total({name: term for name, term in terms.items() if name != "pull"}))
        assert "pull" in terms or len(costs) > 1
    assert "pull" not in terms
    assert sum(costs[-10:]) < 0.5 * sum(costs[:10])


def test_a_view_without_foreground_teaches_emptiness(shards, plane_network):
    """Nothing to see, depth at infinity, one view of one object: finite terms; gradients make the box emptier."""
    sample = view_samples.load(shards / "one" / "rig_0.npz", plane_network)
    size = sample.truth.mask.shape
    far = torch.full(size, torch.inf)
    empty = replace(sample, truth=SurfaceMaps(torch.zeros(size), far, torch.zeros(size[0], 3, *size[1:])))
    ball = Solid(0.6, torch.zeros(3))
    config = replace(FEW, views=1, fewer_views=1.0)
    terms = sample_loss(ball, empty, config, torch.Generator().manual_seed(0))
    sum(terms.values()).backward()
    depth, mask, normal = (float(terms[name].detach()) for name in ("depth", "mask", "normal"))
    assert depth == 0.0 == normal < mask
    assert bool(ball.radius.grad.isfinite()) and float(ball.radius.grad) > 0.0
    gone = Solid(-1.0, torch.zeros(3))  # No surface, and rightly so.
    terms = sample_loss(gone, empty, config, torch.Generator().manual_seed(0))
    sum(terms.values()).backward()
    assert total(terms) == 0.0 and float(gone.radius.grad) == 0.0


def test_a_fit_leaves_weights_a_record_and_a_picture(shards, tmp_path, monkeypatch):
    monkeypatch.setattr(georm_surface, "TINY_SURFACE", FEW)
    output = tmp_path / "surface.safetensors"
    words = ["fit", "georm-surface", "--shards", str(shards), "--steps", "3", "--log-every", "1", "--recompute"]
    assert command.main([*words, "--output", str(output), "--fewer-views", "0.5", "--average", "0"]) == 0
    config, state = checkpoints.load(output, ReconstructionConfig)
    assert config == TINY
    checkpoints.restore(GeoRM(config), state, output)
    record = tmp_path / "runs" / "surface"
    assert {"config.json", "scalars.csv", "validation.png"} <= {path.name for path in record.iterdir()}
    rows = (record / "scalars.csv").read_text().splitlines()
    assert sum(row.startswith("3,mean,loss") for row in rows) == 1 and "3,validation,mask" in "\n".join(rows)


def test_an_output_that_cannot_be_written_is_said_before_the_first_step(shards, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    words = ["fit", "georm-surface", "--shards", str(shards), "--output", str(tmp_path / "file" / "x.safetensors")]
    assert command.main(words) == 1
    assert f"{tmp_path / 'file'}: is a file, not a folder" in capsys.readouterr().err
