"""GlossyRM on GeoRM's shape: roughness and metallic of its vertices, rendered and compared (ARM, equation 3).

The shape is made of each sample's own views by GeoRM, which stays as it is. GlossyRM begins with GeoRM's weights. The
images of both maps are compared where prediction and truth show the object.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from arm_blender.errors import CheckpointError
from arm_blender.graphics.raster.rasterize import interpolate, rasterize_views
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import EncodedPlanes, ReconstructionConfig
from arm_blender.weight_files import checkpoints

from .. import distributed
from ..datasets import view_samples
from ..datasets.gloss_samples import GlossSample, Shapes
from ..losses import image_loss
from ..picture_grid import grid
from ..surface_rendering import POINTS_AT_ONCE
from . import rendered_views
from .rendered_views import CONFIGS, StepConfig, ViewStage, asked_for, encode, fit

MAPS = ("roughness", "metallic")


@dataclass(frozen=True)
class GlossyConfig(StepConfig):
    """What a step renders. The defaults are the paper's, and InstantMesh's where it is silent."""

    grid: int = 256
    """Samples of GeoRM's density along a side of the box (paper: 256)."""
    side: int = 512
    """Pixels of a view; at least 11, as SSIM needs."""


TINY_GLOSSY = GlossyConfig(grid=64, side=96, views=4, fewer_views=0.1)
"""For two CPU cores."""


def sample_loss(
    model: GlossyRM, sample: GlossSample, config: GlossyConfig, draws: torch.Generator, bfloat16: bool = False
) -> dict[str, Tensor]:
    """The image loss of either map, for one object.

    Args:
        bfloat16: encode so; the rest is in float32.
    """
    encoded = encode(model, sample, config.fewer_views, draws, bfloat16)
    chosen = torch.randperm(len(sample.c2w), generator=draws)[: config.views]
    found, truth, mask = rendered(model, encoded, sample, chosen, config.side)
    return {
        name: image_loss(found[:, k : k + 1], truth[:, k : k + 1], mask, perceptual=config.perceptual)
        for k, name in enumerate(MAPS)
    }


def rendered(
    model: GlossyRM, encoded: EncodedPlanes, sample: GlossSample, chosen: Tensor, side: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Views of index `chosen`: (V, 2, side, side) both maps predicted, and true, and (V, side, side) where to compare.

    Only vertices that are seen are predicted.
    """
    cameras = view_samples.cameras(sample, chosen, side)
    fragments = rasterize_views(sample.vertices, sample.faces, cameras)
    seen = sample.faces[fragments.face_id[fragments.mask]].unique()
    values = vertex_values(model, encoded, sample.vertices[seen])
    gloss = values.new_zeros(len(sample.vertices), 2).index_copy(0, seen, values)
    found = torch.stack([interpolate(gloss, sample.faces, fragments[k]) for k in range(len(cameras))])
    truth, mask = (view_samples.resampled(x, chosen, side) for x in (sample.gloss, sample.truth.mask[:, None]))
    return found, truth, fragments.mask & (mask[:, 0] > 0.5)


def vertex_values(model: GlossyRM, encoded: EncodedPlanes, points: Tensor) -> Tensor:
    """(N, 2) at world points (N, 3), in parts that are computed again for the gradient."""

    def part(some: Tensor) -> Tensor:
        return model(encoded, some[None])[0]

    if not len(points):  # Nothing is asked, and the network learns nothing: a gradient of zeros.
        return part(points.new_zeros(1, 3))[:0]
    parts = [checkpoint(part, some, use_reentrant=False) for some in points.split(POINTS_AT_ONCE)]
    return torch.cat(parts)


@torch.no_grad()
def validation_terms(
    model: GlossyRM, sample: GlossSample, config: GlossyConfig, draws: torch.Generator
) -> dict[str, Tensor]:
    """The loss, and the mean absolute error of either map beside that of its own true mean in these views."""
    terms = sample_loss(model, sample, replace(config, fewer_views=0.0), draws)
    encoded, every = encode(model, sample, 0.0, draws, False), torch.arange(len(sample.c2w))
    found, truth, mask = rendered(model, encoded, sample, every, config.side)
    for k, name in enumerate(MAPS):
        own, true = found[:, k][mask], truth[:, k][mask]
        terms[f"{name} error"] = (own - true).abs().sum() / mask.sum().clamp(min=1)
        terms[f"{name} error of the mean"] = (true - true.mean()).abs().sum() / mask.sum().clamp(min=1)
    return terms


@torch.no_grad()
def picture(model: GlossyRM, sample: GlossSample, config: GlossyConfig) -> Tensor:
    """The input views; roughness predicted and true; metallic predicted and true."""
    encoded = encode(model, sample, 0.0, torch.Generator(), False)
    inputs = torch.arange(sample.inputs.images.shape[1])
    found, truth, mask = rendered(model, encoded, sample, inputs, config.side)
    maps = [torch.where(mask[:, None], x[:, k : k + 1], 1.0) for k in (0, 1) for x in (found, truth)]
    return grid([sample.inputs.images[0, :, :3], *maps], min(config.side, 256))


def start(preset: str, georm: Path) -> GlossyRM:
    """GlossyRM of a preset, with GeoRM's weights.

    Raises:
        CheckpointError: they are of other sizes.
    """
    model = GlossyRM(CONFIGS[preset])
    try:
        model.load_geometry(checkpoints.load(georm, ReconstructionConfig)[1])
    except (KeyError, RuntimeError) as error:
        raise CheckpointError(
            f"{georm}: its sizes are not those of the GlossyRM of --preset {preset}; give the GeoRM of that preset"
        ) from error
    return model


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit glossyrm` takes."""
    rendered_views.add_arguments(parser, ("tiny", "paper"))
    parser.add_argument("--georm", type=Path, required=True, help="GeoRM's weights: of the shapes, and to start from")
    parser.add_argument("--shapes", type=Path, help="folder that keeps GeoRM's shapes; without it they are made anew")


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    torch.manual_seed(args.seed)
    config = asked_for(args, TINY_GLOSSY if args.preset == "tiny" else GlossyConfig())
    model = start(args.preset, args.georm)
    shapes = Shapes(args.georm, config.grid, distributed.device(args.device), args.shapes)
    stage = ViewStage[GlossyRM, GlossSample](
        "glossyrm",
        lambda path: shapes.load(path, model.config),
        lambda model, sample, draws: sample_loss(model, sample, config, draws, args.bfloat16),
        lambda model, sample, draws: validation_terms(model, sample, config, draws),
        lambda model, sample: picture(model, sample, config),
    )
    return fit(args, model, stage)
