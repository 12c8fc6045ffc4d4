"""Stage 0 of GeoRM: an occupancy warm-up, for who starts without InstantMesh's weights.

Not in the paper, which starts from a pretrained model. The decoder's raw value over the iso value is trained as the
logit of a soft occupancy, sigmoid(signed distance / temperature), at points around the visible surface: about a hundred
times cheaper a step than volume rendering, and it leaves a density whose iso-surface is the object.
"""

import argparse
import logging
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from arm_blender.errors import ArmError
from arm_blender.graphics.visual_hull import Outlines
from arm_blender.models.network_views import NetworkViews
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.reconstruction import SMALL, SMALL_TRIPLANE, EncodedViews
from arm_blender.weight_files import checkpoints

from .. import distributed
from ..datasets import outline_samples, point_samples
from ..datasets.outline_samples import OutlineBatch
from ..datasets.point_samples import (
    PointSample,
    SampleCache,
    depth_loss,
    load_occupancy,
)
from ..rendering import shards
from ..trainer import Trainer
from .view_side import encode_outlines, silence_features, view_side

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


def loss_terms(
    model: GeoRM, encoded: EncodedViews, outlines: Outlines, points: Tensor, distance: Tensor
) -> dict[str, Tensor]:
    """The occupancy losses of the network and, weighted, of its volume's own vote, at world points (B, P, 3).

    Args:
        outlines: of the encoded views; a network without pixel-aligned features does not know them.
        distance: (B, P) to the true surface, world units, positive inside.
    """
    with torch.no_grad():
        hull = outlines.hull_distance(points)
    terms = {"occupancy": occupancy_loss(model.occupancy_logit(encoded, points), distance, hull)}
    if encoded.volume is not None:
        terms["coarse"] = COARSE_WEIGHT * occupancy_loss(model.coarse_logit(encoded, points), distance, hull)
    return terms


def outline_terms(model: GeoRM, batch: OutlineBatch, bfloat16: bool) -> dict[str, Tensor]:
    """As `loss_terms`, where the network sees outlines and colours alone."""
    with torch.autocast(batch.points.device.type, torch.bfloat16, enabled=bfloat16):
        encoded = encode_outlines(model, batch.outlines, batch.colors)
    return loss_terms(model, encoded.float(), batch.outlines, batch.points, batch.distance)


def intersection_over_union(predicted: Tensor, truth: Tensor) -> float:
    return float((predicted & truth).sum() / (predicted | truth).sum().clamp(min=1))


@torch.no_grad()
def validate(samples: list[PointSample], logit: Callable[[NetworkViews, Tensor], Tensor]) -> dict[str, float]:
    """IoU at the sampled points of objects that training never sees, beside the visual hull's.

    Args:
        logit: of the occupancy (B, P) that compact views show at world points (B, P, 3).
    """
    if not samples:
        return {}
    ours, hull = [], []
    for sample in samples:
        views, points, truth = sample.views, sample.points[None].float(), sample.target[:, 0] > 0
        outlines = Outlines(views.silhouette.float(), views.c2w, views.K)
        ours.append(intersection_over_union(logit(views, points)[0] > 0, truth))
        hull.append(intersection_over_union(outlines.hull_distance(points)[0] > 0, truth))
    return {"iou": float(np.mean(ours)), "hull iou": float(np.mean(hull))}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    point_samples.add_arguments(parser, minutes=60.0, points=6144, learning_rate=4e-4)
    parser.add_argument(
        "--outlines", type=int, default=0, help="objects a step of which outlines and colours alone are shown"
    )
    parser.add_argument(
        "--no-pixel-aligned", action="store_true", help="an ablation: triplanes alone, without hull and volumes"
    )


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    if args.no_pixel_aligned and (args.look_once or args.no_features or args.outlines):
        raise ArmError("--no-pixel-aligned: --look-once, --no-features and --outlines need what it leaves out")
    torch.manual_seed(args.seed)
    model = GeoRM(SMALL_TRIPLANE if args.no_pixel_aligned else SMALL)
    if args.start:
        checkpoints.restore(model, checkpoints.load(args.start, type(SMALL))[1], args.start)
    side = view_side(model, load_occupancy, args)
    samples = SampleCache(args.shards, side.load, shards.real_objects(args.data), side.pictures)
    solids = outline_samples.load_solids(args.shards) if args.outlines else []
    trainer = Trainer.from_arguments(model, args)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        draws = distributed.generator(args.seed, index)
        batch = samples.batch(args.batch, args.points, draws)
        with torch.autocast(batch.points.device.type, torch.bfloat16, enabled=args.bfloat16):
            encoded = side.encode(model, batch.views)
        encoded = encoded.float()
        outlines = Outlines(batch.views.silhouette.float(), batch.views.c2w, batch.views.K)
        terms = loss_terms(model, encoded, outlines, batch.points, batch.target[..., 0])
        if encoded.views is not None:
            terms["depth"] = DEPTH_WEIGHT * depth_loss(encoded.views.depth, batch.depth)
        if args.outlines:
            drawn = outline_samples.batch(solids, args.outlines, args.points, draws)
            terms["outlines"] = sum(outline_terms(model, drawn, args.bfloat16).values())
        return sum(terms.values()), {name: float(term.detach()) for name, term in terms.items()}

    def check(averaged: GeoRM) -> dict[str, float]:
        return validate(
            samples.held_out, lambda views, points: averaged.occupancy_logit(side.encode(averaged, views), points)
        )

    averaged = trainer.run(step, check)
    if args.no_features:
        silence_features(averaged)  # The spread of no features is not quite zero, and was learnt from.
    if distributed.rank() == 0:
        checkpoints.save(args.output, averaged.state_dict(), model.config, name="small.georm")
    return 0
