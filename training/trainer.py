"""The training loop that every stage shares: a time budget, a schedule, an average of the weights, and a resume file.

A run may be stopped at any moment and goes on from its last resume file; what it leaves behind is whole. Under
`torchrun` each process draws its own samples and all take the same step (see distributed.py).
"""

import argparse
import copy
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from arm_blender.files import whole_file

from . import distributed

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainerConfig:
    """How long, how fast, and how often to look and to save."""

    minutes: float = 60.0
    """Wall-clock budget; the learning rate falls to zero over it. Time spent before a resume counts."""
    learning_rate: float = 1e-3
    """Of Adam. The paper's 4e-5 suits its size; a network of a million weights wants more."""
    warmup_steps: int = 100
    """Steps over which the learning rate rises."""
    weight_decay: float = 0.01
    clip: float = 1.0
    """Largest norm of the gradient."""
    average: float = 0.998
    """Of the exponential moving average whose weights are shipped; about the last 500 steps."""
    log_every: int = 50
    """Steps between log lines."""
    save_every_minutes: float = 4.0


def add_arguments(parser: argparse.ArgumentParser, minutes: float, points: int, learning_rate: float) -> None:
    """The options of a stage that learns from points, with that stage's defaults."""
    parser.add_argument("--shards", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True, help="safetensors file of the weights")
    parser.add_argument("--start", type=Path, help="the stage's own weights to go on from")
    parser.add_argument("--minutes", type=float, default=minutes)
    parser.add_argument("--batch", type=int, default=2, help="objects a step")
    parser.add_argument("--points", type=int, default=points, help="points an object")
    parser.add_argument("--learning-rate", type=float, default=learning_rate)
    parser.add_argument("--bfloat16", action="store_true", help="encode in bfloat16: faster where the CPU knows it")
    parser.add_argument("--seed", type=int, default=0)


class Trainer:
    """Runs `loss(step) -> (loss, named numbers to log)` until the budget is spent.

    Args:
        model: trained in place.
        config: of the loop.
        resume: file of the loop's state; continued from if it exists.
    """

    def __init__(self, model: nn.Module, config: TrainerConfig, resume: Path) -> None:
        distributed.join()
        self.model, self.config, self.resume = model, config, resume
        # A frozen parameter that was given a gradient, if only of zeros, would still decay.
        self.trained = [parameter for parameter in model.parameters() if parameter.requires_grad]
        self.optimizer = torch.optim.AdamW(
            self.trained, lr=config.learning_rate, betas=(0.9, 0.98), weight_decay=config.weight_decay
        )
        self.averaged = copy.deepcopy(model).requires_grad_(False).eval()
        self.step, self.spent = 0, 0.0
        if resume.exists():
            state = torch.load(resume, weights_only=True)
            model.load_state_dict(state["model"])
            self.averaged.load_state_dict(state["averaged"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.spent = state["step"], state["spent"]
            logger.info("going on from step %d after %.1f minutes", self.step, self.spent / 60.0)

    def save(self) -> None:
        state = {
            "model": self.model.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "spent": self.spent,
        }
        with whole_file(self.resume) as temporary:
            torch.save(state, temporary)

    def learning_rate(self) -> float:
        """Linear warm-up, then a cosine over the time budget."""
        warmup = min(1.0, (self.step + 1) / self.config.warmup_steps)
        fraction = min(1.0, self.spent / (60.0 * self.config.minutes))
        return self.config.learning_rate * warmup * 0.5 * (1.0 + math.cos(math.pi * fraction))

    @torch.no_grad()
    def update_average(self) -> None:
        decay = min(self.config.average, (self.step + 1) / (self.step + 10))
        for mine, theirs in zip(self.averaged.state_dict().values(), self.model.state_dict().values(), strict=True):
            if mine.is_floating_point():
                mine.lerp_(theirs, 1.0 - decay)
            else:
                mine.copy_(theirs)

    def run(
        self, loss: Callable[[int], tuple[Tensor, dict[str, float]]], validate: Callable[[nn.Module], dict[str, float]]
    ) -> nn.Module:
        """Train until the budget is spent; returns the averaged model."""
        totals: dict[str, float] = {}
        last_save = time.monotonic()
        while self.spent < 60.0 * self.config.minutes:
            started = time.monotonic()
            for group in self.optimizer.param_groups:
                group["lr"] = self.learning_rate()
            value, numbers = loss(self.step)
            self.optimizer.zero_grad(set_to_none=True)
            value.backward()
            seconds = distributed.average_gradients(self.trained, time.monotonic() - started)
            norm = nn.utils.clip_grad_norm_(self.model.parameters(), self.config.clip)
            # One bad sample must not end a night's run, nor enter the weights.
            if bool(norm.isfinite()):
                self.optimizer.step()
                self.update_average()
            self.step += 1
            self.spent += seconds
            for key, number in {"loss": float(value.detach()), **numbers}.items():
                totals[key] = totals.get(key, 0.0) + number / self.config.log_every
            if self.step % self.config.log_every == 0:
                self.report("mean", totals)
                totals = {}
            if time.monotonic() - last_save > 60.0 * self.config.save_every_minutes:
                self.keep(validate)
                last_save = time.monotonic()
        self.keep(validate)
        distributed.leave()
        return self.averaged

    def keep(self, validate: Callable[[nn.Module], dict[str, float]]) -> None:
        """Save and validate, in one of the processes: all have the same weights."""
        if distributed.rank() == 0:
            self.save()
            self.report("validation", validate(self.averaged))

    def report(self, what: str, numbers: dict[str, float]) -> None:
        if distributed.rank() > 0:
            return
        text = ", ".join(f"{key} {number:.4f}" for key, number in numbers.items())
        logger.info("step %d, %.1f min, %s: %s", self.step, self.spent / 60.0, what, text)
