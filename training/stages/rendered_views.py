"""The stages that render what a network predicts and compare it with a rig's views: what they share.

A step takes some objects, each turned and scaled at random, shows the network six of their views or fewer, and adds the
losses of what is rendered. Over all processes each sample is taken once before any comes again.
"""

import argparse
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from arm_blender.errors import ArmError
from arm_blender.models.image_encoder import ImageEncoderConfig
from arm_blender.models.network_views import NetworkViews
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import INSTANTMESH, PAPER, EncodedPlanes, ReconstructionConfig
from arm_blender.models.transformer import TransformerConfig
from arm_blender.models.triplane import DecoderConfig, UpsamplerConfig
from arm_blender.weight_files import checkpoints

from .. import distributed, options
from ..datasets import view_samples
from ..datasets.point_samples import drop_views, is_held_out
from ..datasets.view_samples import Sample, ViewSample
from ..feature_distance import FeatureDistance
from ..losses import Perceptual
from ..lpips import Lpips
from ..rendering import shards
from ..trainer import Trainer

logger = logging.getLogger(__name__)

Network = GeoRM | GlossyRM

TINY = ReconstructionConfig(
    ImageEncoderConfig(image_size=160, position_grid=10, width=96, depth=3, heads=6),
    TransformerConfig(width=96, layers=3, heads=6, grid=16),
    UpsamplerConfig(filters=48, blocks=1, growth=16, doublings=2, channels=16),
    DecoderConfig(hidden_layers=3, hidden=64),
)
"""The paper's networks at a size at which its stages can be tried on two CPU cores; far too small to learn much."""

CONFIGS = {"tiny": TINY, "paper": PAPER, "instantmesh": INSTANTMESH}
"""What --preset names."""

Config = TypeVar("Config", bound="StepConfig")

VALIDATED = 16
"""Held-out samples at most in a validation."""

Model = TypeVar("Model", GeoRM, GlossyRM)

Terms = Callable[[Model, Sample, torch.Generator], dict[str, Tensor]]
"""The loss of a model on one sample, term by term, of what is drawn at random from a generator."""


@dataclass(frozen=True)
class ViewStage(Generic[Model, Sample]):
    """What makes a stage.

    Attributes:
        network: whose weights it leaves, "georm" or "glossyrm".
        load: a `rig_<k>.npz` as a sample; of a class of the stage's own, perhaps.
        terms: in training.
        validation: the same where every view is shown.
        picture: (3, H, W) in [0, 1]: inputs, predictions and truth of a sample.
    """

    network: str
    load: Callable[[Path], Sample]
    terms: Terms[Model, Sample]
    validation: Terms[Model, Sample]
    picture: Callable[[Model, Sample], Tensor]


@dataclass(frozen=True, kw_only=True)
class StepConfig:
    """What is shown and rendered in a step of every stage; the default is the paper's."""

    views: int = 10
    """Rendered in a step, those that are input among them (the paper's N); drawn anew where the rig has more."""
    fewer_views: float = 0.0
    """Share of the steps that show the network 1 to 5 of the six input views."""
    perceptual: Perceptual | None = None
    """LPIPS where its weights are at hand; without it normals are compared by their cosine, and images have no
    perceptual term."""


def add_arguments(parser: argparse.ArgumentParser, presets: tuple[str, ...] = tuple(CONFIGS)) -> None:
    """What `python -m training fit` takes for these stages; the rate is the paper's."""
    options.add_arguments(parser, minutes=60.0, learning_rate=4e-5, presets=presets)
    perceptual = parser.add_mutually_exclusive_group()
    perceptual.add_argument("--lpips", type=Path, help="weights of LPIPS (VGG), to compare pictures as the paper does")
    perceptual.add_argument("--feature-distance", action="store_true", help="instead: EfficientNet-Lite0's")
    parser.add_argument("--fewer-views", type=float, help="share of the steps that show 1 to 5 of the six views")
    parser.add_argument("--device", default="cpu", help="cpu or cuda; under torchrun each process takes its own")


def asked_for(args: argparse.Namespace, config: Config) -> Config:
    """A stage's config with what the arguments say."""
    perceptual: Perceptual | None
    if args.feature_distance:
        perceptual = FeatureDistance.installed()
    else:
        perceptual = Lpips.from_file(args.lpips) if args.lpips else None
    fewer_views = config.fewer_views if args.fewer_views is None else args.fewer_views
    return replace(config, perceptual=perceptual, fewer_views=fewer_views)


def encode(
    model: Network, sample: ViewSample, fewer_views: float, draws: torch.Generator, bfloat16: bool
) -> EncodedPlanes:
    """The input views, all or in a share of the steps fewer, as points are decoded from; in float32.

    Args:
        bfloat16: encode so.
    """
    keep, inputs = drop_views(draws, fewer_views), sample.inputs
    images, silhouette, c2w, K = (x[:, keep] for x in (inputs.images, inputs.silhouette, inputs.c2w, inputs.K))
    inputs = NetworkViews(images, silhouette, c2w, K)
    with torch.autocast(inputs.images.device.type, torch.bfloat16, enabled=bfloat16):
        encoded = model.encode(inputs)
    return encoded.float()


def fit_georm(
    args: argparse.Namespace,
    config: Any,
    sample_loss: Callable[..., dict[str, Tensor]],
    picture: Callable[[GeoRM, ViewSample, Any], Tensor],
) -> int:
    """`fit` of GeoRM in the preset's size, by the loss of a stage of its own.

    Args:
        config: of the stage; its `fewer_views` is for training only.
        sample_loss: of a model, a sample, a config, a generator and whether to encode in bfloat16.
        picture: as of `ViewStage`, of a model, a sample and the config.
    Raises:
        ArmError: as `fit`.
    """
    torch.manual_seed(args.seed)
    network, whole = CONFIGS[args.preset], replace(config, fewer_views=0.0)
    stage = ViewStage[GeoRM, ViewSample](
        "georm",
        lambda path: view_samples.load(path, network),
        lambda model, sample, draws: sample_loss(model, sample, config, draws, args.bfloat16),
        lambda model, sample, draws: sample_loss(model, sample, whole, draws, False),
        lambda model, sample: picture(model, sample, config),
    )
    return fit(args, GeoRM(network), stage)


def fit(args: argparse.Namespace, model: Model, stage: ViewStage[Model, Sample]) -> int:
    """Train and write the averaged weights.

    Raises:
        ArmError: there are no samples to train on.
    """
    training, held_out = split(args.shards)
    device = distributed.device(args.device)
    loop = Trainer.from_arguments(model.to(device), args)

    def step(index: int) -> tuple[Tensor, dict[str, float]]:
        draws = distributed.generator(args.seed, index)
        totals: dict[str, Tensor] = {}
        for number in distributed.share(len(training), args.seed, index, args.batch):
            sample = view_samples.moved(stage.load(training[number]), draws)
            for name, term in stage.terms(model, view_samples.on_device(sample, device), draws).items():
                totals[name] = totals.get(name, 0.0) + term / args.batch
        return sum(totals.values(), torch.zeros(())), {name: float(term.detach()) for name, term in totals.items()}

    def check(averaged: Model) -> dict[str, float]:
        return validate(averaged, held_out[:VALIDATED], stage, device)

    def picture(averaged: Model) -> Tensor:
        sample = stage.load((held_out or training)[0])
        return stage.picture(averaged, view_samples.on_device(sample, device))

    averaged = loop.run(step, check, picture)
    if distributed.rank() == 0:
        metadata = {"steps": str(loop.step), "samples": str(len(training))}
        name = f"{args.preset}.{stage.network}"
        checkpoints.save(args.output, averaged.state_dict(), model.config, name, metadata)
    return 0


def split(folder: Path) -> tuple[list[Path], list[Path]]:
    """The samples to train on, and those that only validate.

    Raises:
        ArmError: there are none to train on.
    """
    paths = shards.rigs(folder)
    training, held_out = ([path for path in paths if is_held_out(path) == which] for which in (False, True))
    if not training:
        raise ArmError(f"{folder}: all of its {len(paths)} samples only validate; render more objects")
    if distributed.rank() == 0:
        logger.info("%d samples to train on, %d held out", len(training), len(held_out))
    return training, held_out


@torch.no_grad()
def validate(
    model: Model, paths: list[Path], stage: ViewStage[Model, Sample], device: torch.device
) -> dict[str, float]:
    """The mean terms over samples that training never sees, always drawn alike."""
    totals: dict[str, float] = {}
    for path in paths:
        sample = view_samples.on_device(stage.load(path), device)
        for name, term in stage.validation(model, sample, torch.Generator().manual_seed(0)).items():
            totals[name] = totals.get(name, 0.0) + float(term) / len(paths)
    return totals
