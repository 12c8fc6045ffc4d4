"""GeoRM of `small`: what shapes are like, from outlines and colours of objects that never come twice alike.

Not in the paper. Nothing is rendered: outlines are drawn of stretched and turned meshes, and colours taken along.
"""

import argparse

import numpy as np
import torch
from torch import Tensor

from arm_blender.models.small.volume_georm import VolumeGeoRM, VolumeGeoRMConfig
from arm_blender.weight_files import checkpoints

from .. import distributed
from ..datasets import outline_samples, point_samples
from ..datasets.outline_samples import OutlineBatch
from ..datasets.point_samples import PointSample, expanded
from ..trainer import Trainer
from .occupancy_loss import intersection_over_union, occupancy_loss

COARSE_WEIGHT = 0.5
"""On the volumes' own vote. Without it the points' own look-up explains what is easy, and the volume, whose first steps
help no one, never learns what only neighbours tell."""


def loss_terms(model: VolumeGeoRM, batch: OutlineBatch, bfloat16: bool) -> dict[str, Tensor]:
    """The occupancy losses of the network and, weighted, of its volumes' own vote.

    Args:
        bfloat16: encode so; the rest is in float32.
    """
    with torch.autocast(batch.points.device.type, torch.bfloat16, enabled=bfloat16):
        encoded = model.encode_outlines(batch.outlines, batch.colors)
    encoded, points = encoded.float(), batch.points
    with torch.no_grad():
        hull = batch.outlines.hull_distance(points)
    own, coarse = model.occupancy_logit(encoded, points), model.coarse_logit(encoded, points)
    return {
        "occupancy": occupancy_loss(own, batch.distance, hull),
        "coarse": COARSE_WEIGHT * occupancy_loss(coarse, batch.distance, hull),
    }


@torch.no_grad()
def validate(model: VolumeGeoRM, samples: list[PointSample]) -> dict[str, float]:
    """IoU at the sampled points of objects that training never sees, beside the visual hull's."""
    if not samples:
        return {}
    ours, hull = [], []
    for sample in samples:
        points, truth = sample.points[None].float(), sample.distance > 0
        encoded = model.encode(expanded(sample.views))
        found, outlines = model.occupancy_logit(encoded, points), encoded.views.outlines
        ours.append(intersection_over_union(found[0] > 0, truth))
        hull.append(intersection_over_union(outlines.hull_distance(points)[0] > 0, truth))
    return {"iou": float(np.mean(ours)), "hull iou": float(np.mean(hull))}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the stage."""
    point_samples.add_arguments(parser, minutes=60.0, points=8192, learning_rate=1e-3)


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    torch.manual_seed(args.seed)
    model = VolumeGeoRM(VolumeGeoRMConfig())
    solids, held_out = outline_samples.load_solids(args.shards), point_samples.load_held_out(args.shards)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        batch = outline_samples.batch(solids, args.batch, args.points, distributed.generator(args.seed, index))
        terms = loss_terms(model, batch, args.bfloat16)
        return sum(terms.values(), torch.zeros(())), {name: float(term.detach()) for name, term in terms.items()}

    averaged = Trainer.from_arguments(model, args).run(step, lambda averaged: validate(averaged, held_out))
    if distributed.rank() == 0:
        checkpoints.save(args.output, averaged.state_dict(), model.config, name="small.georm", half=True)
    return 0
