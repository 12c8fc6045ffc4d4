"""Fit delighting: the light that views were taken under and the albedo without it, at points of GeoRM's shapes.

Not in the paper. The error is that of sRGB albedo, its root taken object by object: dark objects count as much as
bright ones, and the hopeless ones no more than others.
"""

import argparse
import logging
from pathlib import Path

import torch
from torch import Tensor

from arm_blender.errors import ArmError
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.models.small.delighting import Delighting, DelightingConfig, SeenPoints
from arm_blender.weight_files import checkpoints

from .. import distributed, options
from ..datasets.delighting_augmentation import augmented, exposed, fitted_light
from ..datasets.delighting_samples import DelightingSample, prepare, samples
from ..datasets.gloss_samples import Shapes
from ..datasets.point_samples import is_held_out
from ..rasterized.pictures import read_library
from ..trainer import Trainer

logger = logging.getLogger(__name__)

BY_LIGHT_ALONE = 0.3
"""Weight of the albedo that the light alone leaves, beside the corrected one's: so that the light is one."""

SOFT = 1e-4
"""Squared error under which an object is right."""

VALIDATED = 64
"""Held-out samples at most."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit delighting` takes."""
    parser.add_argument("--shards", type=Path, help="rendered rigs; samples are made of those that --cache lacks")
    parser.add_argument("--georm", type=Path, help="GeoRM's weights, whose shapes they lie on; those that ship")
    parser.add_argument("--data", type=Path, help="textures and environments; ARM_DATA by default, else made ones")
    parser.add_argument("--cache", type=Path, required=True, help="folder of samples")
    parser.add_argument("--copies", type=int, default=6, help="of each rig, rasterised with other materials and light")
    parser.add_argument("--grid", type=int, default=64, help="samples of the density along a side, for the shapes")
    parser.add_argument("--output", type=Path, required=True, help="checkpoint, for `fit instant-albedo --delighting`")
    parser.add_argument("--start", type=Path, help="weights of this stage to go on from")
    parser.add_argument("--batch", type=int, default=8, help="objects a step")
    parser.add_argument("--points", type=int, default=768, help="of each")
    options.add_loop_arguments(parser, minutes=60.0, learning_rate=1e-3)


def run(args: argparse.Namespace) -> int:
    """Prepare and fit; returns the exit status."""
    library = read_library(args.data)
    if args.shards is not None:
        georm = args.georm or checkpoints.shipped("small.georm")
        shapes = Shapes(georm, args.grid, torch.device("cpu"), args.cache / "shapes")
        logger.info("%d samples in %s", prepare(args.shards, args.cache, shapes, library, args.copies), args.cache)
    known = [exposed(sample) for sample in samples(args.cache)]
    training = [sample for sample in known if not is_held_out(Path(sample.name) / "rig")]
    held_out = [sample for sample in known if is_held_out(Path(sample.name) / "rig")][:VALIDATED]
    if not training:
        raise ArmError(f"{args.cache}: no samples; give --shards, the folder that `python -m training render` wrote")
    lights = [fitted_light(sample) for sample in training]
    torch.manual_seed(args.seed)
    model = Delighting(DelightingConfig())
    loop = Trainer.from_arguments(model, args)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        random = distributed.generator(args.seed, index)
        drawn = torch.randint(len(training), (args.batch,), generator=random).tolist()
        batch = [augmented(training[k], lights[k], args.points, library, random) for k in drawn]
        return delighting_loss(model, batch)

    averaged = loop.run(step, lambda model: validate(model, held_out))
    if distributed.rank() == 0:
        metadata = {"samples": str(len(training)), "steps": str(loop.step)}
        checkpoints.save(args.output, averaged.state_dict(), averaged.config, "delighting", metadata)
    return 0


def delighting_loss(model: Delighting, batch: list[DelightingSample]) -> tuple[Tensor, dict[str, float]]:
    """Root of the mean squared error of sRGB albedo, the mean over samples of equally many points and views."""
    names = ("position", "normal", "color", "visible", "eyes")
    points = SeenPoints(*(torch.cat([getattr(sample.points, name) for sample in batch]) for name in names))
    albedo = torch.cat([sample.albedo for sample in batch])
    found = model(points)
    seen = points.visible.any(dim=1)
    error, by_light, blend = (_root(x, albedo, seen).mean() for x in (found.albedo, found.even, points.blended()))
    numbers = {"error": float(error.detach()), "by light": float(by_light.detach()), "blend": float(blend)}
    return error + BY_LIGHT_ALONE * by_light, numbers


@torch.no_grad()
def validate(model: Delighting, held_out: list[DelightingSample]) -> dict[str, float]:
    """Mean root of the squared errors: of the albedo, of that by the light alone, and of the views' blend."""
    found = []
    for sample in held_out:
        result, seen = model(sample.points), sample.points.visible.any(dim=1)
        tried = (result.albedo, result.even, sample.points.blended())
        found.append([float(_root(x.clamp(0.0, 1.0), sample.albedo, seen)) for x in tried])
    means = torch.tensor(found).mean(dim=0).tolist() if found else []
    return dict(zip(("error", "by light", "blend"), means, strict=False))


def _root(found: Tensor, truth: Tensor, seen: Tensor) -> Tensor:
    """(B,) root mean square of the sRGB difference of linear colours (B, P, 3) at seen points (B, P)."""
    # What is too bright keeps a gradient to come back by.
    found = torch.where(found > 1.0, 1.0 + 0.1 * (found - 1.0), found).clamp(1e-4, 1.2)
    error = (srgb_from_linear(found) - srgb_from_linear(truth)).square().mean(dim=-1)
    return ((error * seen).sum(dim=1) / seen.sum(dim=1).clamp(min=1) + SOFT).sqrt()
