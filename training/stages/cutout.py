"""Fit the network that cuts the object out of a photograph: on scenes with masks, and on composites of them.

Not in the paper, which is given pictures without surroundings.
"""

import argparse
import logging
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from arm_blender.errors import ArmError
from arm_blender.models.small.cutout import Cutout, CutoutConfig
from arm_blender.weight_files import checkpoints

from .. import distributed, options
from ..datasets.cutout_samples import drawn, plain, read_scenes
from ..datasets.places import read_places
from ..picture_grid import grid
from ..trainer import Trainer

logger = logging.getLogger(__name__)

COARSE_WEIGHT = 0.5
"""Of the coarsest level's cross-entropy: without it nothing tells the attention what it is for, for a long time."""

SHOWN = 12
"""Held-out pictures in `validation.png`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit cutout` takes."""
    parser.add_argument("--scenes", type=Path, required=True, help="folder of `render --layout scenes`")
    parser.add_argument("--data", type=Path, help="environments and textures to lay objects over; ARM_DATA by default")
    parser.add_argument("--more", type=Path, nargs="*", default=(), help="further data folders")
    parser.add_argument("--output", type=Path, required=True, help="safetensors file of the weights, float16")
    parser.add_argument("--start", type=Path, help="weights of this stage to go on from")
    parser.add_argument("--batch", type=int, default=12, help="pictures a step")
    parser.add_argument("--size", type=int, default=160, help="pixels a side of a sample, a multiple of 16")
    options.add_loop_arguments(parser, minutes=45.0, learning_rate=2e-3)


def run(args: argparse.Namespace) -> int:
    """Fit; returns the exit status."""
    known = read_scenes(args.scenes)
    training = [scenes for scenes in known if not scenes.held_out]
    held_out = [scenes for scenes in known if scenes.held_out]
    if not training:
        raise ArmError(f"{args.scenes}: every object only validates; render more")
    folders = [args.data, *args.more] if args.data is not None else []
    places = [place for folder in folders for place in read_places(folder, args.seed)]
    logger.info("%d objects over %d places, %d more validate", len(training), len(places), len(held_out))
    torch.manual_seed(args.seed)
    model = Cutout(CutoutConfig())
    loop = Trainer.from_arguments(model, args)
    validated = plain(held_out, args.size) if held_out else None

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        srgb, alpha = drawn(training, args.size, args.batch, distributed.generator(args.seed, index), places)
        return cutout_loss(*model.both(srgb), alpha)

    averaged = loop.run(
        step,
        lambda model: validate(model, validated) if validated else {},
        (lambda model: pictures(model, validated)) if validated else None,
    )
    if distributed.rank() == 0:
        metadata = {"objects": str(len(training)), "steps": str(loop.step)}
        checkpoints.save(args.output, averaged.state_dict(), averaged.config, "cutout", metadata, half=True)
    return 0


def cutout_loss(logits: Tensor, coarse: Tensor, alpha: Tensor) -> tuple[Tensor, dict[str, float]]:
    """Cross-entropy of the pixels, coarse and fine, and one minus the soft intersection over union of each picture.

    Args:
        logits, alpha: (B, 1, H, W).
        coarse: (B, 1, h, w), compared with the mean of alpha there.
    """
    found = logits.sigmoid()
    cross = functional.binary_cross_entropy_with_logits(logits, alpha)
    overlap = (found * alpha).sum(dim=(1, 2, 3))
    union = (found + alpha - found * alpha).sum(dim=(1, 2, 3))
    # A handful of pixels on both sides: pictures without an object ask for none, and have a gradient.
    missed = (1.0 - (overlap + 20.0) / (union + 20.0)).mean()
    mean = functional.adaptive_avg_pool2d(alpha, (coarse.shape[-2], coarse.shape[-1]))
    below = functional.binary_cross_entropy_with_logits(coarse, mean)
    return cross + missed + COARSE_WEIGHT * below, {
        "cross entropy": float(cross.detach()),
        "missed": float(missed.detach()),
    }


@torch.no_grad()
def validate(model: Cutout, held_out: tuple[Tensor, Tensor]) -> dict[str, float]:
    """Mean intersection over union with the true masks, its lowest tenth, and the cross-entropy."""
    scores, cross = [], []
    for srgb, alpha in zip(held_out[0].split(8), held_out[1].split(8), strict=True):
        logits = model(srgb)
        cross.append(functional.binary_cross_entropy_with_logits(logits, alpha, reduction="none").mean(dim=(1, 2, 3)))
        found, true = logits > 0.0, alpha > 0.5
        scores.append((found & true).sum(dim=(1, 2, 3)) / (found | true).sum(dim=(1, 2, 3)).clamp(min=1))
    score = torch.cat(scores)
    return {"IoU": float(score.mean()), "tenth": float(score.quantile(0.1)), "cross": float(torch.cat(cross).mean())}


@torch.no_grad()
def pictures(model: Cutout, held_out: tuple[Tensor, Tensor]) -> Tensor:
    """(3, H, W): photographs, the alpha found, the true one."""
    srgb, alpha = (values[:: max(1, len(values) // SHOWN)][:SHOWN] for values in held_out)
    return grid([srgb, model(srgb).sigmoid(), alpha], 128)
