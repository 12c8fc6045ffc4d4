"""The loop: it learns, survives a bad sample, and goes on from its file."""

import argparse
import math

import pytest
import torch
from torch import nn

from arm_blender.errors import ArmError, CheckpointError
from training import options, trainer
from training.trainer import Trainer, TrainerConfig


@pytest.fixture
def clock(monkeypatch):
    """A second passes whenever the time is asked for: budgets without waiting."""
    ticks = iter(range(10**9))
    monkeypatch.setattr(trainer.time, "monotonic", lambda: float(next(ticks)))


def line() -> nn.Linear:
    torch.manual_seed(0)
    return nn.Linear(1, 1)


def squared_error(model: nn.Linear):
    x = torch.linspace(-1, 1, 20)[:, None]

    def loss(step: int):
        return (model(x) - (2.0 * x + 1.0)).square().mean(), {}

    return loss


def nothing(model: nn.Module) -> dict[str, float]:
    return {}


CONFIG = TrainerConfig(minutes=15.0, learning_rate=0.05, warmup_steps=5, weight_decay=0.0, average=0.9)


def test_it_learns_a_line(tmp_path, clock):
    model = line()
    averaged = Trainer(model, CONFIG, tmp_path / "line.resume").run(squared_error(model), nothing)
    assert float(averaged.weight) == pytest.approx(2.0, abs=0.05) and float(averaged.bias) == pytest.approx(
        1.0, abs=0.05
    )


def test_a_sample_without_a_finite_gradient_changes_nothing(tmp_path, clock, caplog):
    model = line()
    before = {key: value.clone() for key, value in model.state_dict().items()}

    def every_other(step: int):
        return model.weight.sum() * (math.nan if step % 2 else 0.0), {}

    config = TrainerConfig(steps=40, weight_decay=0.0, log_every=40, bad_steps=2)
    with caplog.at_level("INFO"):
        averaged = Trainer(model, config, tmp_path / "nan.resume").run(every_other, nothing)
    assert "skipped steps 20" in caplog.text
    for key, value in before.items():
        assert torch.equal(model.state_dict()[key], value) and torch.equal(averaged.state_dict()[key], value)


def test_gradients_that_stay_without_a_number_end_the_run_in_one_line(tmp_path):
    model, config = line(), TrainerConfig(steps=100, bad_steps=4)
    before = model.weight.detach().clone()
    loop = Trainer(model, config, tmp_path / "nan.resume")
    with pytest.raises(ArmError, match=r"nan.resume: 4 steps in a row up to step 11 .* lower --learning-rate"):
        loop.run(lambda step: (model.weight.sum() * (math.nan if step > 6 else 1.0), {}), nothing)
    assert bool(model.weight.isfinite().all()) and not torch.equal(model.weight, before)
    assert Trainer(line(), config, tmp_path / "nan.resume").step == 11


def test_a_budget_of_steps_is_kept_and_the_rate_follows_it(tmp_path):
    rates, config = [], TrainerConfig(steps=20, learning_rate=0.1, warmup_steps=1, weight_decay=0.0)
    loop = Trainer(line(), config, tmp_path / "steps.resume")
    error = squared_error(loop.model)

    def loss(step: int):
        rates.append(loop.optimizer.param_groups[0]["lr"])
        return error(step)

    loop.run(loss, nothing)
    assert loop.step == 20
    assert rates == pytest.approx([0.05 * (1.0 + math.cos(math.pi * step / 20)) for step in range(20)])


def test_without_an_average_the_model_itself_is_returned(tmp_path):
    model = line()
    config = TrainerConfig(steps=3, average=0.0)
    assert Trainer(model, config, tmp_path / "plain.resume").run(squared_error(model), nothing) is model
    assert model.training


def test_a_resume_file_of_another_run_is_refused_in_one_line(tmp_path):
    path = tmp_path / "line.resume"
    Trainer(line(), TrainerConfig(steps=1), path).run(lambda step: (line().weight.sum(), {}), nothing)
    with pytest.raises(CheckpointError, match="line.resume: was begun with --seed 0, not 1"):
        Trainer(line(), TrainerConfig(steps=2, seed=1), path)
    with pytest.raises(CheckpointError, match="line.resume: is damaged, or of another network"):
        Trainer(nn.Linear(2, 1), TrainerConfig(steps=2), path)
    for damaged in (path.read_bytes()[:100], b"nothing", b""):
        path.write_bytes(damaged)
        with pytest.raises(CheckpointError, match="line.resume: is damaged"):
            Trainer(line(), TrainerConfig(steps=2), path)


def test_a_spent_budget_is_not_spent_again(tmp_path, clock):
    model = line()
    first = Trainer(model, CONFIG, tmp_path / "line.resume")
    first.run(squared_error(model), nothing)
    again = Trainer(line(), CONFIG, tmp_path / "line.resume")
    assert again.step == first.step and again.spent == first.spent
    result = again.run(squared_error(again.model), nothing)
    assert again.step == first.step and torch.equal(result.weight, first.averaged.weight)


def test_the_learning_rate_rises_and_falls_to_zero(tmp_path):
    loop = Trainer(line(), CONFIG, tmp_path / "rate.resume")
    assert loop.learning_rate() == pytest.approx(CONFIG.learning_rate / CONFIG.warmup_steps)
    loop.step, loop.spent = 100, 30.0 * CONFIG.minutes
    assert loop.learning_rate() == pytest.approx(CONFIG.learning_rate / 2.0)
    loop.spent = 60.0 * CONFIG.minutes
    assert loop.learning_rate() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("option", "value", "remedy"),
    [("--steps", "0", "1 or more"), ("--average", "1.5", "0 to 1"), ("--seed", "-1", "0 to 32767")],
)
def test_a_number_out_of_its_range_is_one_line(option, value, remedy):
    parser = argparse.ArgumentParser()
    options.add_loop_arguments(parser, minutes=1.0, learning_rate=1e-3)
    assert options.config(parser.parse_args([])).learning_rate == 1e-3
    with pytest.raises(ArmError, match=f"^{option} {value}.*: give .*{remedy}"):
        options.config(parser.parse_args([option, value]))
