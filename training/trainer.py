"""The training loop that every stage shares: a budget, a schedule, an average of the weights, and a resume file.

A run may be stopped at any moment and goes on from its last resume file with the losses that it would have had: what a
step draws at random is a function of the seed and of the step's number. What it leaves behind is whole. Under
`torchrun` each process takes its own samples and all take the same step (see distributed.py).
"""

import argparse
import copy
import logging
import math
import time
from collections.abc import Callable
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor, nn

from arm_blender.commands.progress_line import rest_of
from arm_blender.errors import ArmError, CheckpointError
from arm_blender.machine.files import whole_file
from arm_blender.weight_files import checkpoints

from . import blocks, distributed
from .options import TrainerConfig, config
from .run_record import RunRecord

logger = logging.getLogger(__name__)

Loss = Callable[[int], tuple[Tensor, dict[str, float]]]
"""Of a step's number: what is minimised, and named numbers to log."""

Model = TypeVar("Model", bound=nn.Module)

Validate = Callable[[Model], dict[str, float]]
"""Named numbers of a model on samples that training never sees."""

Pictures = Callable[[Model], Tensor]
"""(3, H, W) in [0, 1]: inputs, predictions and truth side by side."""


class Trainer(Generic[Model]):
    """Runs `loss(step)` until the budget is spent.

    Args:
        model: trained in place, on the device where it is.
        config: of the loop.
        resume: file of the loop's state; continued from if it exists. Its folder is made.
        record: of what happens; None logs lines only.
    Raises:
        CheckpointError: `resume` is of another network, or of another seed.
    """

    def __init__(self, model: Model, config: TrainerConfig, resume: Path, record: RunRecord | None = None) -> None:
        distributed.join()
        resume.parent.mkdir(parents=True, exist_ok=True)
        self.model, self.config, self.resume = model, config, resume
        self.record = record or RunRecord(None)
        # A frozen parameter that was given a gradient, if only of zeros, would still decay.
        self.trained = [parameter for parameter in model.parameters() if parameter.requires_grad]
        self.optimizer = torch.optim.AdamW(
            self.trained, lr=config.learning_rate, betas=(0.9, 0.98), weight_decay=config.weight_decay
        )
        self.averaged = copy.deepcopy(model).requires_grad_(False).eval() if config.average else model
        self.step, self.spent = 0, 0.0
        self.skipped, self.bad = 0, 0  # Steps without a finite gradient: in all, and in a row.
        self.totals: dict[str, float] = {}
        if resume.exists():
            self._load()
        self.record.rewind(self.step)
        if config.recompute:
            blocks.recompute(model)
        if config.compile:
            blocks.compile_blocks(model)

    @classmethod
    def from_arguments(cls, model: Model, args: argparse.Namespace) -> "Trainer[Model]":
        """As the options of every stage say, with a record in runs/NAME/ beside the output NAME.safetensors.

        A model of `model.config` begins with the weights of `args.start`, where they are given.

        Raises:
            CheckpointError: those are damaged, or of another network.
        """
        if args.start:
            own: Any = model.config
            checkpoints.restore(model, checkpoints.load(args.start, type(own))[1], args.start)
        return cls(model, config(args), args.output.with_suffix(".resume"), RunRecord.beside(args.output, vars(args)))

    def save(self) -> None:
        state = {
            "model": self.model.state_dict(),
            "averaged": self.averaged.state_dict() if self.config.average else {},
            "optimizer": self.optimizer.state_dict(),
            **{name: getattr(self, name) for name in _COUNTED},
            "seed": self.config.seed,
        }
        with whole_file(self.resume) as temporary:
            torch.save(state, temporary)

    def _load(self) -> None:
        remedy = "remove it, or give another --output"
        try:
            state = torch.load(self.resume, weights_only=True, map_location="cpu")
            if state["seed"] != self.config.seed:
                raise CheckpointError(
                    f"{self.resume}: was begun with --seed {state['seed']}, not {self.config.seed}; {remedy}"
                )
            self.model.load_state_dict(state["model"])
            if self.config.average:
                self.averaged.load_state_dict(state["averaged"] or state["model"])
            self.optimizer.load_state_dict(state["optimizer"])
            for name in _COUNTED:
                setattr(self, name, state[name])
        except (RuntimeError, KeyError, ValueError, EOFError, OSError, UnpicklingError) as error:
            raise CheckpointError(
                f"{self.resume}: is damaged, or of another network or version ({error}); {remedy}"
            ) from error
        logger.info("going on from step %d after %.1f minutes", self.step, self.spent / 60.0)

    def progress(self) -> float:
        """Share of the budget that is spent."""
        spent, budget = self.spent, 60.0 * self.config.minutes
        if self.config.steps is not None:
            spent, budget = self.step, self.config.steps
        return 1.0 if spent >= budget else spent / budget

    def learning_rate(self) -> float:
        """Linear warm-up, over a tenth of a budget of steps at most, then a cosine over the budget."""
        rising = self.config.warmup_steps
        if self.config.steps is not None:
            rising = min(rising, max(1, self.config.steps // 10))
        warmup = min(1.0, (self.step + 1) / rising)
        return self.config.learning_rate * warmup * 0.5 * (1.0 + math.cos(math.pi * self.progress()))

    @torch.no_grad()
    def update_average(self) -> None:
        decay = min(self.config.average, (self.step + 1) / (self.step + 10))
        for mine, theirs in zip(self.averaged.state_dict().values(), self.model.state_dict().values(), strict=True):
            if mine.is_floating_point():
                mine.lerp_(theirs, 1.0 - decay)
            else:
                mine.copy_(theirs)

    def run(self, loss: Loss, validate: Validate[Model], pictures: Pictures[Model] | None = None) -> Model:
        """Train until the budget is spent; returns the averaged model.

        Raises:
            ArmError: one gradient after the other is not finite.
        """
        last_save = time.monotonic()
        while self.progress() < 1.0:
            numbers = self.take_step(loss)
            for key, number in numbers.items():
                self.totals[key] = self.totals.get(key, 0.0) + number / self.config.log_every
            self.record.show(self.progress(), f"step {self.step}, loss {numbers['loss']:.4f}")
            if self.step % self.config.log_every == 0:
                self.report("mean", {**self.totals, "skipped steps": float(self.skipped)})
                self.totals = {}
            if self.bad >= self.config.bad_steps:
                self._give_up()
            if time.monotonic() - last_save > 60.0 * self.config.save_every_minutes:
                self.keep(validate, pictures)
                last_save = time.monotonic()
        self.keep(validate, pictures)
        self.record.close()
        distributed.leave()
        return self.averaged

    def take_step(self, loss: Loss) -> dict[str, float]:
        """One step of the optimiser, or none where the gradient is not finite; returns the numbers to log."""
        started = time.monotonic()
        torch.manual_seed(distributed.step_seed(self.config.seed, self.step))  # For who draws without a generator.
        rate = self.learning_rate()
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        value, numbers = loss(self.step)
        self.optimizer.zero_grad(set_to_none=True)
        value.backward()
        seconds = distributed.average_gradients(self.trained, time.monotonic() - started)
        norm = nn.utils.clip_grad_norm_(self.trained, self.config.clip)
        # One bad sample must not end a night's run, nor enter the weights.
        if bool(norm.isfinite()):
            self.optimizer.step()
            if self.config.average:
                self.update_average()
            self.bad = 0
        else:
            self.skipped, self.bad = self.skipped + 1, self.bad + 1
        self.step += 1
        self.spent += seconds
        return {"loss": float(value.detach()), **numbers, "learning rate": rate, "gradient norm": float(norm)}

    def _give_up(self) -> None:
        if distributed.rank() == 0:
            self.save()
        self.record.close()
        distributed.leave()
        raise ArmError(
            f"{self.resume}: {self.bad} steps in a row up to step {self.step} had no finite gradient, and the weights "
            "are those before them; lower --learning-rate, or look for a damaged sample"
        )

    def keep(self, validate: Validate[Model], pictures: Pictures[Model] | None = None) -> None:
        """Save and validate, in one of the processes: all have the same weights."""
        if distributed.rank() > 0:
            return
        self.save()
        training = self.averaged.training
        self.averaged.eval()
        with torch.no_grad():
            if numbers := validate(self.averaged):
                self.report("validation", numbers)
            if pictures is not None:
                self.record.picture(self.step, pictures(self.averaged))
        self.averaged.train(training)

    def report(self, what: str, numbers: dict[str, float]) -> None:
        if distributed.rank() > 0:
            return
        done, said = self.progress(), ", ".join(f"{key} {number:.4g}" for key, number in numbers.items())
        self.record.line(
            "step %d, %.1f min, %.0f%%%s, %s: %s",
            self.step, self.spent / 60.0, 100.0 * done, rest_of(self.spent, done), what, said,
        )  # fmt: skip
        self.record.scalars(self.step, what, numbers)


_COUNTED = ("step", "spent", "skipped", "bad", "totals")
"""What of a `Trainer` a resume file holds beside the weights."""
