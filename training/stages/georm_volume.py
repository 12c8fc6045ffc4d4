"""Stage 1 of GeoRM: the density is rendered as a volume, and its mask, depth and normals compared (ARM, supplement).

After InstantMesh's first stage, which the paper names: windows of a rig's ten views at random resolutions, 64 coarse
and 64 importance samples a ray. The loss is the paper's for its shapes, equation 2.
"""

import argparse
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from arm_blender.errors import ArmError
from arm_blender.models.paper.georm import RAW_ISO, GeoRM
from arm_blender.models.paper.reconstruction import EncodedPlanes

from ..datasets import view_samples
from ..datasets.view_samples import Crop, ViewSample
from ..losses import SurfaceMaps, geometry_loss
from ..picture_grid import grid, normals
from ..volume_rendering import Rays, SamplingConfig, draw, render
from . import rendered_views
from .rendered_views import StepConfig, asked_for, encode, fit_georm


@dataclass(frozen=True)
class VolumeConfig(StepConfig):
    """What a step renders. The defaults are the paper's, and InstantMesh's where it is silent."""

    sampling: SamplingConfig = SamplingConfig()
    """Of each ray."""
    window: int = 192
    """Pixels a side of what is rendered of a view. LPIPS needs 32."""
    resolutions: tuple[int, int] = (192, 512)
    """Pixels that the whole view has, least and most: the smaller, the more of the object is in a window."""


TINY_VOLUME = VolumeConfig(
    SamplingConfig(coarse=32, fine=32), views=4, window=32, resolutions=(48, 128), fewer_views=0.1
)
"""A hundredth of the paper's samples a step, for two CPU cores."""


def surface_maps(
    model: GeoRM, encoded: EncodedPlanes, window: Crop, config: VolumeConfig, draws: torch.Generator
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
    encoded = encode(model, sample, config.fewer_views, draws, bfloat16)
    return rendering_loss(model, encoded, sample, config, draws)


def rendering_loss(
    model: GeoRM, encoded: EncodedPlanes, sample: ViewSample, config: VolumeConfig, draws: torch.Generator
) -> dict[str, Tensor]:
    """As `sample_loss`, where the views are encoded already."""
    chosen = torch.randperm(len(sample.c2w), generator=draws)[: config.views]
    least, most = config.resolutions
    side = int(torch.randint(least, most + 1, (), generator=draws))
    window = view_samples.crop(sample, chosen, side, config.window, draws)
    found = surface_maps(model, encoded, window, config, draws)
    return geometry_loss(found, window.truth, config.perceptual)


def picture(model: GeoRM, sample: ViewSample, config: VolumeConfig) -> Tensor:
    """The input views, their rendered normals, and the true ones; each view whole, a window large."""
    draws, side = torch.Generator().manual_seed(0), config.window
    inputs = torch.arange(sample.inputs.images.shape[1])
    window = view_samples.crop(sample, inputs, side, side, draws)
    found = surface_maps(model, encode(model, sample, 0.0, draws, False), window, config, draws)
    return grid([sample.inputs.images[0, :, :3], normals(found), normals(window.truth)], max(side, 96))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit georm-volume` takes."""
    rendered_views.add_arguments(parser)
    parser.add_argument("--window", type=int, help="pixels a side of what is rendered of a view; a step's time")


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    config = TINY_VOLUME if args.preset == "tiny" else VolumeConfig()
    window = config.window if args.window is None else args.window
    least = 32 if args.lpips or args.feature_distance else 1  # Those distances take no less.
    if not least <= window <= config.resolutions[0]:
        raise ArmError(f"--window {window}: give {least} to {config.resolutions[0]}")
    config = replace(asked_for(args, config), window=window)
    return fit_georm(args, config, sample_loss, picture)
