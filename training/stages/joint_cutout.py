"""Fit the network that cuts the object out of photographs whose cameras are known, by all of them together.

Not in the paper, which is given pictures without surroundings.
"""

import argparse
import logging
from pathlib import Path

import torch
from torch import Tensor

from arm_blender.commands.progress_line import Counted
from arm_blender.errors import ArmError
from arm_blender.models.small.cutout import Cutout
from arm_blender.photographs.masks.joint_look import CONFIG
from arm_blender.weight_files import checkpoints

from .. import distributed, options
from ..datasets.joint_samples import drawn, plain, read_capture
from ..picture_grid import grid
from ..trainer import Trainer
from .cutout import SHOWN, cutout_loss, validate

logger = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit joint-cutout` takes."""
    parser.add_argument("--captures", type=Path, required=True, help="folder of `render --layout capture`")
    parser.add_argument("--output", type=Path, required=True, help="safetensors file of the weights, float16")
    parser.add_argument("--start", type=Path, help="weights of this stage to go on from")
    parser.add_argument("--batch", type=int, default=12, help="windows a step")
    parser.add_argument("--size", type=int, default=CONFIG.closer_side, help="pixels a side of one, a multiple of 16")
    options.add_loop_arguments(parser, minutes=40.0, learning_rate=2e-3)


def run(args: argparse.Namespace) -> int:
    """Fit; returns the exit status."""
    folders = sorted(path.parent for path in args.captures.glob("*/truth.json"))
    samples, count = [], Counted(len(folders), logger.info)
    for folder in folders:
        samples.append(read_capture(folder, args.size, args.seed))
        count(folder.name)
    training = [item for item in samples if not item.held_out]
    held_out = [item for item in samples if item.held_out]
    if not training:
        raise ArmError(f"{args.captures}: no capture of an object that does not only validate; render more")
    torch.manual_seed(args.seed)
    model = Cutout(CONFIG)
    loop = Trainer.from_arguments(model, args)
    validated = plain(held_out) if held_out else None

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        inputs, alpha = drawn(training, args.batch, distributed.generator(args.seed, index))
        return cutout_loss(*model.both(inputs), alpha)

    averaged = loop.run(
        step,
        lambda model: validate(model, validated) if validated else {},
        (lambda model: pictures(model, validated)) if validated else None,
    )
    if distributed.rank() == 0:
        metadata = {"captures": str(len(training)), "steps": str(loop.step)}
        checkpoints.save(args.output, averaged.state_dict(), averaged.config, "cutout", metadata, half=True)
    return 0


@torch.no_grad()
def pictures(model: Cutout, held_out: tuple[Tensor, Tensor]) -> Tensor:
    """(3, H, W): photographs, what all masks have in common, the alpha found, the true one."""
    inputs, alpha = (values[:: max(1, len(values) // SHOWN)][:SHOWN] for values in held_out)
    return grid([inputs[:, :3], 0.5 + 0.5 * inputs[:, 5:6], model(inputs).sigmoid(), alpha], 128)
