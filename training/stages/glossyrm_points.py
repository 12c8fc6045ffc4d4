"""GlossyRM, warmed up: roughness and metallic at points of the true surface, GeoRM's weights to start from.

Not in the paper, which compares rendered maps (stage `glossyrm`). The squared error at points needs no shape from GeoRM
and no rendering, and many more objects pass in a minute.
"""

import argparse
import logging
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional as F

from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import SMALL_GLOSSY, ReconstructionConfig
from arm_blender.weight_files import checkpoints

from .. import distributed
from ..datasets import point_samples
from ..datasets.point_samples import (
    PointSample,
    SampleCache,
    depth_loss,
    load_gloss,
)
from ..rendering import shards
from ..trainer import Trainer
from .view_side import EveryStep, Once, view_side

logger = logging.getLogger(__name__)

DEPTH_WEIGHT = 0.1


@torch.no_grad()
def validate(model: GlossyRM, samples: list[PointSample], constant: Tensor, side: EveryStep | Once) -> dict[str, float]:
    """Mean absolute errors on objects that training never sees, beside those of the training mean, a (2,) constant."""
    if not samples:
        return {}
    errors = []
    for sample in samples:
        truth = sample.target.float()
        predicted = model(side.encode(model, sample.views), sample.points[None].float())[0]
        errors.append(torch.cat([(predicted - truth).abs().mean(0), (constant - truth).abs().mean(0)]))
    mean = torch.stack(errors).mean(0).tolist()
    return dict(zip(("roughness", "metallic", "constant roughness", "constant metallic"), mean, strict=True))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    point_samples.add_arguments(parser, minutes=20.0, points=2048, learning_rate=4e-4)
    parser.add_argument("--georm", type=Path, help="GeoRM's weights to start from")


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    torch.manual_seed(args.seed)
    model = GlossyRM(SMALL_GLOSSY)
    if args.georm:
        model.load_geometry(checkpoints.load(args.georm, ReconstructionConfig)[1])
    if args.start:
        checkpoints.restore(model, checkpoints.load(args.start, ReconstructionConfig)[1], args.start)
    side = view_side(model, load_gloss, args)
    samples = SampleCache(args.shards, side.load, shards.real_objects(args.data), side.pictures)
    constant = torch.stack([s.target.float().mean(0) for s in samples.training]).mean(0)
    trainer = Trainer.from_arguments(model, args)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        batch = samples.batch(args.batch, args.points, distributed.generator(args.seed, index))
        with torch.autocast(batch.points.device.type, torch.bfloat16, enabled=args.bfloat16):
            encoded = side.encode(model, batch.views)
        encoded = encoded.float()
        gloss = F.mse_loss(model(encoded, batch.points), batch.target)
        depth = depth_loss(encoded.views.depth, batch.depth)
        # The depth keeps what GeoRM has learnt of where the surface is.
        return gloss + DEPTH_WEIGHT * depth, {"gloss": float(gloss.detach()), "depth": float(depth.detach())}

    averaged = trainer.run(step, lambda m: validate(m, samples.held_out, constant, side))
    if distributed.rank() == 0:
        checkpoints.save(args.output, averaged.state_dict(), SMALL_GLOSSY, name="small.glossyrm")
    return 0
