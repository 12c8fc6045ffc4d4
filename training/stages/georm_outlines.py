"""Before GeoRM's other stages: what shapes are like, from outlines and colours alone.

Not in the paper. The field's side of the network (volume, reader, decoder) sees no image features, and for depth where
rays meet the visual hull. Nothing is rendered, and no shape comes twice. Image features have no say in what this leaves
until a later stage gives them one.
"""

import argparse

import torch
from torch import Tensor

from arm_blender.graphics.visual_hull import Outlines
from arm_blender.models.network_views import NetworkViews
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.reconstruction import SMALL
from arm_blender.models.small.feature_volume import object_colors
from arm_blender.weight_files import checkpoints

from .. import distributed
from ..datasets import outline_samples, point_samples
from ..datasets.point_samples import expanded
from ..trainer import Trainer
from .georm_occupancy import outline_terms, validate
from .view_side import VIEW_SIDE, encode_outlines, freeze, silence_features


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the stage."""
    point_samples.add_point_arguments(parser, minutes=30.0, points=8192, learning_rate=1e-3)


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    torch.manual_seed(args.seed)
    model = GeoRM(SMALL)
    if args.start:
        checkpoints.restore(model, checkpoints.load(args.start, type(SMALL))[1], args.start)
    for name in VIEW_SIDE:
        freeze(model.model, name)
    silence_features(model)
    solids, held_out = outline_samples.load_solids(args.shards), point_samples.load_held_out(args.shards)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        batch = outline_samples.batch(solids, args.batch, args.points, distributed.generator(args.seed, index))
        terms = outline_terms(model, batch, args.bfloat16)
        return sum(terms.values()), {name: float(term.detach()) for name, term in terms.items()}

    def check(averaged: GeoRM) -> dict[str, float]:
        def logit(views: NetworkViews, points: Tensor) -> Tensor:
            outlines = Outlines(views.silhouette.float(), views.c2w, views.K)
            pictures = expanded(views).images.flatten(0, 1)
            colors = object_colors(pictures, SMALL.background, outline_samples.COLORED)[None]
            return averaged.occupancy_logit(encode_outlines(averaged, outlines, colors), points)

        return validate(held_out, logit)

    averaged = Trainer.from_arguments(model, args).run(step, check)
    silence_features(averaged)  # The spread of no features is not quite zero, and was learnt from.
    if distributed.rank() == 0:
        checkpoints.save(args.output, averaged.state_dict(), SMALL, name="small.georm")
    return 0
