"""What one view shows of a shape: occupancy along its rays, learnt from objects that are never seen twice alike.

Not in the paper. Nothing is rendered: objects, stretched and turned, take the colours of their pictures along.
"""

import argparse
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.models.small.ray_occupancy import RayOccupancy, RayOccupancyConfig
from arm_blender.weight_files import checkpoints

from .. import distributed
from ..datasets import one_view_samples, outline_samples, point_samples
from ..datasets.one_view_samples import OneViewBatch
from ..datasets.outline_samples import Solid
from ..datasets.point_samples import rotation_z
from ..rendering import shards
from ..trainer import Trainer
from .occupancy_loss import intersection_over_union, occupancy_loss

NAME = "small.ray_occupancy"

VALIDATION_POINTS = 20_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the stage."""
    point_samples.add_arguments(parser, minutes=60.0, points=8192, learning_rate=1e-3)
    parser.set_defaults(batch=2)
    parser.add_argument("--data", type=Path, help="folder with manifest.json; its real objects are drawn more often")


LAYER_WEIGHT = 1.0
"""On the mean error of the first and of the last surface along rays, world units. Occupancy alone learns slowly: only
where it is wrong it says so, and not how far."""


def answer(model: RayOccupancy, batch: OneViewBatch, bfloat16: bool = False) -> tuple[Tensor, dict[str, Tensor]]:
    """The logits (B, P) at the points of a batch, and the losses."""
    with torch.autocast(batch.points.device.type, torch.bfloat16, enabled=bfloat16):
        encoded = model.encode(batch.views)
    encoded = encoded.float()
    with torch.no_grad():
        hull = encoded.outlines.hull_distance(batch.points)
    logit = model.occupancy_logit(encoded, batch.points)
    errors = []
    for side, surface in enumerate((batch.first, batch.last)):
        found, truth = model.layers_at(encoded, surface)
        errors.append((found[..., side] - truth).abs().mean())
    return logit, {
        "occupancy": occupancy_loss(logit, batch.distance, hull),
        "first": LAYER_WEIGHT * errors[0],
        "last": LAYER_WEIGHT * errors[1],
    }


def held_out_views(solids: list[Solid]) -> list[OneViewBatch]:
    """Each object from its four sides, as the evaluation sees it."""
    camera = orbit_camera(0.0, 10.0, 6.0, 30.0, one_view_samples.SIZE, one_view_samples.SIZE)
    views = []
    for solid in solids:
        for quarter in range(4):
            moved = outline_samples.deformed(solid, rotation_z(0.5 * math.pi * quarter), 2.0)
            draws = torch.Generator().manual_seed(quarter)
            views.append(one_view_samples.seen(solid, moved, camera, VALIDATION_POINTS, draws, tint=False))
    return views


def validate(model: RayOccupancy, views: list[OneViewBatch]) -> dict[str, float]:
    """IoU at the sampled points, and the loss, over `held_out_views`; nothing without any."""
    if not views:
        return {}
    found = []
    for view in views:
        logit, terms = answer(model, view)
        overlap = intersection_over_union(logit > 0, view.distance > 0)
        found.append({"iou": overlap} | {name: float(term.detach()) for name, term in terms.items()})
    return {name: float(np.mean([numbers[name] for numbers in found])) for name in found[0]}


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    torch.manual_seed(args.seed)
    model = RayOccupancy(RayOccupancyConfig())
    solids = outline_samples.load_solids(args.shards, cloud=one_view_samples.CLOUD)
    held_out = held_out_views(outline_samples.load_solids(args.shards, held_out=True, cloud=one_view_samples.CLOUD))
    drawn = one_view_samples.Views(solids, shards.real_objects(args.data), args.points, args.seed)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        terms = answer(model, drawn.batch(index, args.batch), args.bfloat16)[1]
        return sum(terms.values(), torch.zeros(())), {name: float(term.detach()) for name, term in terms.items()}

    averaged = Trainer.from_arguments(model, args).run(step, lambda averaged: validate(averaged, held_out))
    if distributed.rank() == 0:
        checkpoints.save(args.output, averaged.state_dict(), model.config, name=NAME, half=True)
    return 0
