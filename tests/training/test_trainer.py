"""The loop: it learns, survives a bad sample, and goes on from its file."""

import math

import pytest
import torch
from torch import nn

from training import trainer
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


def test_a_sample_without_a_finite_gradient_changes_nothing(tmp_path, clock):
    model = line()
    before = {key: value.clone() for key, value in model.state_dict().items()}
    averaged = Trainer(model, TrainerConfig(minutes=0.5), tmp_path / "nan.resume").run(
        lambda step: (model.weight.sum() * math.nan, {}), nothing
    )
    for key, value in before.items():
        assert torch.equal(model.state_dict()[key], value) and torch.equal(averaged.state_dict()[key], value)


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
