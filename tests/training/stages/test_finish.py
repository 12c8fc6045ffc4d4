"""The finish's read-outs in closed form, what folds leave out, and the stage from shards to a checkpoint."""

import math

import numpy as np
import pytest
import torch

from arm_blender import networks
from arm_blender.models.small.finish import COUNT, Finish, FinishConfig
from arm_blender.models.small.volume_georm import VolumeGeoRM, VolumeGeoRMConfig
from arm_blender.weight_files import checkpoints
from training import __main__ as command
from training.datasets import finish_samples
from training.datasets.finish_samples import FinishSample, family, prepare, samples
from training.rendering import shards
from training.stages import finish_folds, finish_readout
from training.stages.finish_folds import area_under_curve, folds, left_out
from training.stages.finish_readout import fit_odds, fit_readout, rows

pytestmark = pytest.mark.usefixtures("one_thread")


def told(name: str, rough: float, seed: int, views: int = 6, own: bool = True) -> FinishSample:
    """Random numbers, of which the first tells the roughness of the object, and the second where it is metal."""
    random = torch.Generator().manual_seed(seed)
    found = torch.randn(300, COUNT, generator=random)
    metal = (found[:, 1] > 0.5).float()
    if own:
        found[:, -3] = rough
    return FinishSample(name, views, True, found, torch.stack([torch.full((300,), rough), metal], dim=1))


def known(count: int = 30) -> list[FinishSample]:
    return [told(f"object {k}", (7 * k % count) / count, k) for k in range(count)]


def test_what_numbers_tell_is_read_of_objects_that_were_left_out():
    model = Finish(FinishConfig()).requires_grad_(False)
    data = rows(known(), model, model.several)
    found = left_out(model, model.several, data)
    assert finish_folds.correlation(found.answer[..., 0].mean(dim=1), data.truth[..., 0].mean(dim=1)) > 0.8
    metal = data.truth[..., 1] > 0.5
    assert area_under_curve(found.metal.flatten(), metal.flatten()) > 0.9
    # What is called certain is so as often as it says.
    sure = found.metal > 0.8
    assert bool(sure.any()) and float(metal[sure].float().mean()) > 0.8


def test_what_nothing_tells_is_the_usual(monkeypatch):
    model = Finish(FinishConfig()).requires_grad_(False)
    data = rows([told(f"object {k}", (7 * k % 30) / 30, k, own=False) for k in range(30)], model, model.several)
    fit_readout(model.several, data, model.config, (1e6, 1e6))
    said = model.read(data.samples[0].found, 6)
    torch.testing.assert_close(said.roughness, torch.full((300,), float(data.truth[..., 0].mean())), atol=1e-3, rtol=0)
    assert not bool(said.metallic.any())


def test_a_ridge_is_that_of_the_textbook():
    """One number that varies within objects alone: slope = covariance / (variance + ridge), of unit variance."""
    model = Finish(FinishConfig(bound=100.0)).requires_grad_(False)
    random, cache = torch.Generator().manual_seed(0), []
    for k in range(4):
        found = torch.zeros(256, COUNT)
        found[:, 5] = torch.linspace(-1.0, 1.0, 256)[torch.randperm(256, generator=random)]
        cache.append(FinishSample(str(k), 6, True, found, 0.5 + 0.1 * found[:, 5:6].expand(-1, 2)))
    fit_readout(model.several, rows(cache, model, model.several), model.config, (1.0, 3.0))
    deviation = float(torch.linspace(-1.0, 1.0, 256).std(correction=0))
    found = model.several.answer.weight[:, 5] / (0.1 * deviation)
    torch.testing.assert_close(found, torch.tensor([1.0 / 2.0, 1.0 / 4.0]), atol=0.01, rtol=0.0)


def test_odds_are_those_of_what_was_seen():
    """Of scores of 1 three of four are metal, of scores of 0 one of four: logits of log 3 and -log 3."""
    score = torch.tensor([[0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0]])
    truth = torch.tensor([[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 0.0]])
    model = Finish(FinishConfig()).requires_grad_(False)
    fit_odds(model.few, score, truth, torch.tensor([0.5, 0.5]))
    found = model.few.odds(torch.tensor([[0.0], [1.0]]))[:, 0]
    torch.testing.assert_close(found, torch.tensor([-math.log(3.0), math.log(3.0)]), atol=0.02, rtol=0.0)


def test_the_highest_scores_are_worth_what_they_were():
    """Half of those that score highest are metal, whatever a curve over all of them says."""
    score, random = torch.linspace(0.0, 1.0, 1000)[None], torch.Generator().manual_seed(0)
    truth = (torch.rand(1, 1000, generator=random) < torch.where(score > 0.9, 0.5, score)).float()
    model = Finish(FinishConfig()).requires_grad_(False)
    fit_odds(model.few, score, truth, torch.ones(1))
    assert float(model.few.metal(score).max()) == pytest.approx(0.6, abs=0.1)


def test_families_are_left_out_whole():
    names = ["chess_king_black", "sf_chess_board", "ur_base", "franka_hand", "ph_tea_set_01", "khr_x_teacup", "a", "b"]
    assert len({family(name) for name in names}) == 5
    fold = dict(zip(names, folds(names).tolist(), strict=True))
    for one, other in zip(names[:6:2], names[1:6:2], strict=True):
        assert fold[one] == fold[other]
    assert len(set(fold.values())) == 5


def test_the_area_under_the_curve_counts_pairs():
    score, positive = torch.tensor([0.1, 0.4, 0.4, 0.9]), torch.tensor([False, True, False, True])
    assert area_under_curve(score, positive) == pytest.approx((1.0 + 0.5 + 1.0 + 1.0) / 4.0)
    assert math.isnan(area_under_curve(score, torch.ones(4, dtype=torch.bool)))


@pytest.fixture
def georm(tmp_path):
    torch.manual_seed(0)
    path = tmp_path / "small.georm.safetensors"
    config = VolumeGeoRMConfig()
    checkpoints.save(path, VolumeGeoRM(config).state_dict(), config, "georm")
    return path


def test_a_sample_has_the_truth_of_its_points(ball_shards, tmp_path, monkeypatch):
    mesh = shards.read_mesh(ball_shards / "one" / "mesh.npz")
    monkeypatch.setattr(finish_samples, "VIEWS", (6, 3))
    shapes = type("True", (), {"refined": staticmethod(lambda path, faces: mesh)})
    monkeypatch.setattr(shards, "rigs", lambda folder: [folder / "one" / "rig_0.npz"])
    rig = shards.arrays(ball_shards / "one" / "rig_0.npz")
    rig |= {"roughness": np.full((10, 48, 48), 102, np.uint8), "metallic": np.full((10, 48, 48), 255, np.uint8)}
    shards.save_arrays(ball_shards / "one" / "rig_0.npz", rig)
    assert prepare(ball_shards, tmp_path / "cache", shapes) == 4
    for sample in samples(tmp_path / "cache"):
        torch.testing.assert_close(sample.truth, torch.tensor([0.4, 1.0]).expand_as(sample.truth), atol=2e-3, rtol=0.0)
        assert sample.name == "one" and bool(sample.found.isfinite().all())
    assert {(s.views, s.true_shape) for s in samples(tmp_path / "cache")} == {(6, 1), (6, 0), (3, 1), (3, 0)}


def test_the_stage_writes_a_finish_that_the_program_reads(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(finish_readout, "POINTS", 64)
    cache, output = tmp_path / "cache", tmp_path / "small.finish.safetensors"
    for sample in [*known(8), *(told(f"object {k}", k / 8, k, views=3) for k in range(8))]:
        arrays = {"found": sample.found.half().numpy(), "truth": sample.truth.half().numpy()}
        shards.save_arrays(cache / f"{sample.name}.rig_0.true.{sample.views}.npz", arrays)
    document = tmp_path / "materials.md"
    document.write_text("<!-- folds:begin -->\n<!-- folds:end -->")
    words = ["fit", "finish", "--cache", str(cache), "--output", str(output), "--update", str(document)]
    assert command.main(words) == 0
    assert (
        "8 measured objects in 8 families" in document.read_text()
        and "python -m training fit finish" in document.read_text()
    )
    said = networks.read("finish", output)(_points())
    assert bool(said.roughness.isfinite().all())


def test_without_objects_the_stage_says_what_it_needs(tmp_path, capsys):
    words = ["fit", "finish", "--cache", str(tmp_path), "--output", str(tmp_path / "x.safetensors")]
    assert command.main(words) == 1
    assert "0 samples of finish: give --shards" in capsys.readouterr().err


def _points():
    from arm_blender.models.small.delighting import SeenPoints

    random = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(1, 90, 3, generator=random), dim=-1)
    color, eyes = torch.rand(1, 4, 90, 3, generator=random), 4.0 * torch.eye(4)[None, :, :3]
    return SeenPoints(normal, normal, color, torch.ones(1, 4, 90, dtype=torch.bool), eyes)
