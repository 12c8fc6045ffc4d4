"""Stage 1 of GeoRM: the density is rendered as a volume, and its mask, depth and normals compared (ARM, supplement).

After InstantMesh's first stage, which the paper names: windows of a rig's ten views at random resolutions, 64 coarse
and 64 importance samples a ray. The loss is the paper's for its shapes, equation 2.
"""

import argparse
import logging
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from arm_blender import checkpoints
from arm_blender.config import PRESETS
from arm_blender.errors import ArmError
from arm_blender.models.georm import RAW_ISO, GeoRM
from arm_blender.models.reconstruction import EncodedViews, NetworkViews, ReconstructionConfig

from .. import distributed, trainer
from ..datasets import shards, view_samples
from ..datasets.point_samples import drop_views, is_held_out
from ..datasets.view_samples import Crop, ViewSample
from ..losses import GeometryLossConfig, Perceptual, SurfaceMaps, geometry_loss
from ..lpips import Lpips
from ..trainer import Trainer
from ..volume_rendering import Rays, SamplingConfig, draw, render

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class VolumeConfig:
    """What a step renders. The defaults are the paper's, and InstantMesh's where it is silent."""

    sampling: SamplingConfig = SamplingConfig()
    """Of each ray."""
    views: int = 10
    """Rendered in a step, those that are input among them (the paper's N); drawn anew where the rig has more."""
    window: int = 192
    """Pixels a side of what is rendered of a view. LPIPS needs 32."""
    resolutions: tuple[int, int] = (192, 512)
    """Pixels that the whole view has, least and most: the smaller, the more of the object is in a window."""
    fewer_views: float = 0.0
    """Share of the steps that show the network 1 to 5 of the six input views."""
    loss: GeometryLossConfig = GeometryLossConfig()
    """Balance of the terms."""
    perceptual: Perceptual | None = None
    """LPIPS where its weights are at hand; without it normals are compared by their cosine."""


VALIDATED = 16
"""Held-out samples at most in a validation."""

SMALL_VOLUME = VolumeConfig(
    SamplingConfig(coarse=32, fine=32), views=4, window=32, resolutions=(48, 128), fewer_views=0.1
)
"""A hundredth of the paper's samples a step, for two CPU cores."""


def surface_maps(
    model: GeoRM, encoded: EncodedViews, window: Crop, config: VolumeConfig, draws: torch.Generator
) -> SurfaceMaps:
    """What the density of one object looks like in a window of each of its views; depth along the view axis."""
    shape = window.truth.mask.shape
    rays = Rays(window.rays.origins.flatten(0, 1)[None], window.rays.directions.flatten(0, 1)[None])  # B = 1
    found = render(
        lambda points: model.occupancy_logit(encoded, points) + RAW_ISO,
        rays,
        draw(rays, config.sampling, draws),
        config.sampling.rays_at_once,
    )
    depth = found.depth.view(shape) * window.cosine.view(shape)
    return SurfaceMaps(found.mask.view(shape), depth, found.normal.view(*shape, 3).movedim(-1, 1))


def sample_loss(
    model: GeoRM, sample: ViewSample, config: VolumeConfig, draws: torch.Generator, bfloat16: bool = False
) -> dict[str, Tensor]:
    """The terms of equation 2 for one object, in windows drawn at random.

    Args:
        bfloat16: encode so; rendering is in float32.
    """
    keep = drop_views(draws, config.fewer_views)
    inputs = sample.inputs
    inputs = NetworkViews(*(x[:, keep] for x in (inputs.images, inputs.silhouette, inputs.c2w, inputs.K)))
    with torch.autocast(inputs.images.device.type, torch.bfloat16, enabled=bfloat16):
        encoded = model.encode(inputs)
    return rendering_loss(model, encoded.float(), sample, config, draws)


def rendering_loss(
    model: GeoRM, encoded: EncodedViews, sample: ViewSample, config: VolumeConfig, draws: torch.Generator
) -> dict[str, Tensor]:
    """As `sample_loss`, where the views are encoded already."""
    chosen = torch.randperm(len(sample.c2w), generator=draws)[: config.views]
    least, most = config.resolutions
    side = int(torch.randint(least, most + 1, (), generator=draws))
    window = view_samples.crop(sample, chosen, side, config.window, draws)
    found = surface_maps(model, encoded, window, config, draws)
    return geometry_loss(found, window.truth, config.loss, config.perceptual)


@torch.no_grad()
def validate(model: GeoRM, paths: list[Path], network: ReconstructionConfig, config: VolumeConfig) -> dict[str, float]:
    """The mean terms over samples that training never sees, always in the same windows."""
    totals: dict[str, float] = {}
    for path in paths:
        draws = torch.Generator().manual_seed(0)
        terms = sample_loss(model, view_samples.load(path, network), replace(config, fewer_views=0.0), draws)
        for name, term in terms.items():
            totals[name] = totals.get(name, 0.0) + float(term) / len(paths)
    return totals


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit georm-volume` takes."""
    trainer.add_arguments(parser, minutes=60.0, learning_rate=4e-5)
    parser.add_argument("--lpips", type=Path, help="weights of LPIPS (VGG), to compare normals as the paper does")


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    torch.manual_seed(args.seed)
    network = PRESETS[args.preset].georm
    config = SMALL_VOLUME if args.preset == "small" else VolumeConfig()
    config = replace(config, perceptual=Lpips.from_file(args.lpips) if args.lpips else None)
    paths = shards.rigs(args.shards)
    training, held_out = ([p for p in paths if is_held_out(p) == which] for which in (False, True))
    if not training:
        raise ArmError(f"{args.shards}: all of its {len(paths)} samples only validate; render more objects")
    logger.info("%d samples to train on, %d held out", len(training), len(held_out))
    model = GeoRM(network)
    if args.start:
        checkpoints.restore(model, checkpoints.load(args.start, ReconstructionConfig)[1], args.start)
    loop = Trainer.from_arguments(model, args)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        draws = distributed.generator(args.seed, index)
        totals: dict[str, Tensor] = {}
        for _ in range(args.batch):
            path = training[int(torch.randint(len(training), (), generator=draws))]
            sample = view_samples.moved(view_samples.load(path, network), draws)
            for name, term in sample_loss(model, sample, config, draws, args.bfloat16).items():
                totals[name] = totals.get(name, 0.0) + term / args.batch
        return sum(totals.values()), {name: float(term.detach()) for name, term in totals.items()}

    averaged = loop.run(step, lambda averaged: validate(averaged, held_out[:VALIDATED], network, config))
    if distributed.rank() == 0:
        metadata = {"steps": str(loop.step), "samples": str(len(training))}
        checkpoints.save(args.output, averaged.state_dict(), network, f"{args.preset}.georm", metadata)
    return 0
