"""How long, how fast and how a stage is fitted: the loop's configuration, and the command line's options for it."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from arm_blender.errors import ArmError


@dataclass(frozen=True)
class TrainerConfig:
    """How long, how fast, and how often to look and to save."""

    minutes: float = 60.0
    """Wall-clock budget; the learning rate falls to zero over it. Time spent before a resume counts."""
    steps: int | None = None
    """Budget in steps, instead of minutes: the same run on every machine, however fast."""
    learning_rate: float = 1e-3
    """Of Adam. The paper's 4e-5 suits its size; a network of a million weights wants more."""
    warmup_steps: int = 100
    """Steps over which the learning rate rises."""
    weight_decay: float = 0.01
    """Of AdamW; 0 is the paper's Adam."""
    clip: float = 1.0
    """Largest norm of the gradient."""
    average: float = 0.998
    """Of the exponential moving average whose weights are shipped; about the last 500 steps. 0 ships the last ones."""
    bad_steps: int = 10
    """Steps in a row without a finite gradient that end the run: single ones are skipped."""
    log_every: int = 50
    """Steps between log lines."""
    save_every_minutes: float = 4.0
    """What a killed run loses at most. Each time the model validates as well."""
    seed: int = 0
    """Of whatever is drawn at random."""
    recompute: bool = False
    """Keep no activations inside repeated blocks: a third more time, a fraction of the memory."""
    compile: bool = False
    """Compile repeated blocks by `torch.compile`; needs a C++ compiler."""


def add_arguments(
    parser: argparse.ArgumentParser, minutes: float, learning_rate: float, presets: tuple[str, ...]
) -> None:
    """The options of every stage that learns from shards, with that stage's defaults; the first preset is one."""
    parser.add_argument("--shards", type=Path, required=True)
    parser.add_argument(
        "--output", type=Path, required=True, help="safetensors file of the weights; runs/NAME/ beside it logs"
    )
    parser.add_argument("--start", type=Path, help="the stage's own weights to go on from")
    parser.add_argument("--preset", choices=presets, default=presets[0], help="sizes of the network and of a step")
    parser.add_argument("--batch", type=int, default=1, help="objects a step in each process; the paper's is 1 in 8")
    parser.add_argument("--bfloat16", action="store_true", help="encode in bfloat16: faster where the device knows it")
    add_loop_arguments(parser, minutes, learning_rate)


def add_loop_arguments(parser: argparse.ArgumentParser, minutes: float, learning_rate: float) -> None:
    """The options of the loop alone; `config` reads them."""
    default = TrainerConfig()
    parser.add_argument("--minutes", type=float, default=minutes, help="of the whole fit, resumed ones included")
    parser.add_argument("--steps", type=int, help="of the whole fit, instead of minutes")
    parser.add_argument("--learning-rate", type=float, default=learning_rate)
    parser.add_argument("--warmup-steps", type=int, default=default.warmup_steps)
    parser.add_argument("--weight-decay", type=float, default=0.0, help="0 is the paper's Adam")
    parser.add_argument("--clip", type=float, default=default.clip, help="largest norm of the gradient")
    parser.add_argument("--average", type=float, default=default.average, help="of the weights, exponential; 0 is none")
    parser.add_argument("--recompute", action="store_true", help="activations of blocks anew for the gradient")
    parser.add_argument("--compile", action="store_true", help="compile repeated blocks; needs a C++ compiler")
    parser.add_argument("--log-every", type=int, default=default.log_every, help="steps")
    parser.add_argument("--save-every", type=float, default=default.save_every_minutes, help="minutes")
    parser.add_argument("--seed", type=int, default=0)


def add_device_arguments(parser: argparse.ArgumentParser) -> None:
    """Where a stage of InstantAlbedo computes, and how."""
    parser.add_argument("--bfloat16", action="store_true", help="predict in bfloat16: faster where the device knows it")
    parser.add_argument("--device", default="cpu", help="cpu or cuda; under torchrun each process takes its own")


def config(args: argparse.Namespace) -> TrainerConfig:
    """What the options of `add_loop_arguments` say.

    Raises:
        ArmError: a number is out of its range.
    """
    for name, low, high in (("steps", 1, None), ("average", 0.0, 1.0), ("clip", 1e-12, None), ("batch", 1, None),
                            ("log_every", 1, None), ("warmup_steps", 1, None), ("seed", 0, 2**15 - 1)):  # fmt: skip
        value = getattr(args, name, None)
        if value is not None and not (value >= low and (high is None or value <= high)):
            raise ArmError(f"--{name.replace('_', '-')} {value}: give {low:g}{f' to {high:g}' if high else ' or more'}")
    same = ("minutes", "steps", "learning_rate", "warmup_steps", "weight_decay", "clip", "average", "log_every", "seed")
    settings = {name: getattr(args, name) for name in (*same, "recompute", "compile")}
    return TrainerConfig(save_every_minutes=args.save_every, **settings)
