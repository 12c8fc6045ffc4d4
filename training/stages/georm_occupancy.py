"""Stage 0 of GeoRM: an occupancy warm-up, for who starts without InstantMesh's weights.

Not in the paper, which starts from a pretrained model. The decoder's raw value over the iso value is trained as the
logit of a soft occupancy, sigmoid(signed distance / temperature), at points around the visible surface: about a hundred
times cheaper a step than volume rendering, and it leaves a density whose iso-surface is the object.
"""

import argparse
import logging

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from arm_blender import checkpoints
from arm_blender.models.georm import GeoRM
from arm_blender.models.reconstruction import SMALL, EncodedViews

from .. import distributed
from ..datasets import point_samples, shards
from ..datasets.point_samples import (
    Batch,
    PointSample,
    SampleCache,
    depth_loss,
    load_occupancy,
)
from ..trainer import Trainer, TrainerConfig
from .view_side import EveryStep, Once, view_side

logger = logging.getLogger(__name__)

TEMPERATURE = 0.02
"""World units a logit. Smaller sharpens the surface and starves far points of gradient."""

UNDECIDED = 3.0
"""Additional weight of points in the hull, away from the surface."""

COARSE_WEIGHT = 0.5
"""On the volume's own vote. Without it the points' own look-up explains what is easy, and the volume, whose first steps
help no one, never learns what only neighbours tell."""

DEPTH_WEIGHT = 0.5
"""The paper's lambda_z, on the depth that each view predicts."""


def occupancy_loss(logit: Tensor, distance: Tensor, hull: Tensor) -> Tensor:
    """Binary cross-entropy against the soft occupancy; its minimum is logit = distance / temperature.

    Points that lie in the visual hull and away from the surface weigh more: whether they are solid or carved is what
    the views' outlines do not say.

    Args:
        logit, distance, hull: (B, P); distances in world units, positive inside.
    """
    error = F.binary_cross_entropy_with_logits(logit, torch.sigmoid(distance / TEMPERATURE), reduction="none")
    weight = 1.0 + UNDECIDED * ((hull > 0.0) & (distance.abs() > 1.5 * TEMPERATURE))
    return (weight * error).sum() / weight.sum()


def loss_terms(model: GeoRM, encoded: EncodedViews, batch: Batch) -> tuple[Tensor, Tensor]:
    """The occupancy losses of the network and of its volume's own vote, at the points of a batch."""
    distance = batch.target[..., 0]
    with torch.no_grad():
        hull = encoded.views.outlines.hull_distance(batch.points)
    vote = model.model.decode_coarse(encoded, batch.points).squeeze(-1) + model.hull_vote(hull)
    return (
        occupancy_loss(model.occupancy_logit(encoded, batch.points), distance, hull),
        occupancy_loss(vote, distance, hull),
    )


def intersection_over_union(predicted: Tensor, truth: Tensor) -> float:
    return float((predicted & truth).sum() / (predicted | truth).sum().clamp(min=1))


@torch.no_grad()
def validate(model: GeoRM, samples: list[PointSample], side: EveryStep | Once) -> dict[str, float]:
    """IoU at the sampled points of objects that training never sees, beside the visual hull's."""
    ours, hull = [], []
    for sample in samples:
        encoded, points = side.encode(model, sample.views), sample.points[None].float()
        truth = sample.target[:, 0] > 0
        ours.append(intersection_over_union(model.occupancy_logit(encoded, points)[0] > 0, truth))
        hull.append(intersection_over_union(encoded.views.outlines.hull_distance(points)[0] > 0, truth))
    return {"iou": float(np.mean(ours)), "hull iou": float(np.mean(hull))}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    point_samples.add_arguments(parser, minutes=60.0, points=6144, learning_rate=4e-4)


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    torch.manual_seed(args.seed)
    model = GeoRM(SMALL)
    if args.start:
        checkpoints.restore(model, checkpoints.load(args.start, type(SMALL))[1], args.start)
    side = view_side(model, load_occupancy, args.look_once, args.freeze)
    samples = SampleCache(args.shards, side.load, shards.real_objects(args.data), side.pictures)
    trainer = Trainer(
        model, TrainerConfig(minutes=args.minutes, learning_rate=args.learning_rate), args.output.with_suffix(".resume")
    )

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        batch = samples.batch(args.batch, args.points, distributed.generator(args.seed, index))
        with torch.autocast(batch.points.device.type, torch.bfloat16, enabled=args.bfloat16):
            encoded = side.encode(model, batch.views)
        encoded = encoded.float()
        occupancy, coarse = loss_terms(model, encoded, batch)
        depth = depth_loss(encoded.views.depth, batch.depth)
        return occupancy + COARSE_WEIGHT * coarse + DEPTH_WEIGHT * depth, {
            "occupancy": float(occupancy.detach()),
            "coarse": float(coarse.detach()),
            "depth": float(depth.detach()),
        }

    averaged = trainer.run(step, lambda m: validate(m, samples.held_out, side))
    if distributed.rank() == 0:
        checkpoints.save(args.output, averaged.state_dict(), SMALL, name="small.georm")
    return 0
