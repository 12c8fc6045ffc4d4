"""Stage 2 of GeoRM: its iso-surface is rasterised, and its mask, depth and normals compared (ARM, section 5.4).

Equation 2 with the paper's weights on ten views of which six are input. It has no regulariser, and neither has this. A
surface that is not there has no gradient: then, and only then, points of the true rays are asked instead, which ought
to be solid behind the true surface and empty before it.
"""

import argparse
from dataclasses import dataclass

import torch
from torch import Tensor

from arm_blender.models.paper.georm import GeoRM

from ..datasets import view_samples
from ..datasets.view_samples import Crop, ViewSample
from ..losses import SurfaceMaps, geometry_loss
from ..picture_grid import grid, normals
from ..surface_rendering import iso_surface, surface_maps
from ..volume_rendering import RawDensity
from . import rendered_views
from .rendered_views import StepConfig, asked_for, encode, fit_georm


@dataclass(frozen=True)
class SurfaceConfig(StepConfig):
    """What a step renders. The defaults are the paper's, and InstantMesh's where it is silent."""

    grid: int = 256
    """Samples of the density along a side of the box (paper: 256)."""
    side: int = 512
    """Pixels of a view. Faces much smaller than a pixel get little gradient at outlines: no coarser than the grid."""
    points: int = 4096
    """Rays that are asked where there is no surface."""


TINY_SURFACE = SurfaceConfig(grid=64, side=96, views=4, fewer_views=0.1)
"""For two CPU cores."""


def sample_loss(
    model: GeoRM, sample: ViewSample, config: SurfaceConfig, draws: torch.Generator, bfloat16: bool = False
) -> dict[str, Tensor]:
    """The terms of equation 2 for one object; "pull" as well where it has no surface.

    Args:
        bfloat16: encode so; the rest is in float32.
    """
    encoded = encode(model, sample, config.fewer_views, draws, bfloat16)

    def field(points: Tensor) -> Tensor:
        return model.occupancy_logit(encoded, points)

    chosen = torch.randperm(len(sample.c2w), generator=draws)[: config.views]
    whole = view_samples.crop(sample, chosen, config.side, config.side, draws)
    found = rendered(field, sample, chosen, config)
    pull = {}
    if found is None:
        found = nothing(whole.truth)
        pull["pull"] = pull_towards_truth(field, whole, config, draws)
    return {**geometry_loss(found, whole.truth, config.perceptual), **pull}


def rendered(field: RawDensity, sample: ViewSample, chosen: Tensor, config: SurfaceConfig) -> SurfaceMaps | None:
    """What the views of index `chosen` see of the field's surface; None where it has none."""
    surface = iso_surface(field, config.grid, sample.c2w.device)
    return None if surface is None else surface_maps(surface, view_samples.cameras(sample, chosen, config.side))


def nothing(like: SurfaceMaps) -> SurfaceMaps:
    """What is seen of nothing."""
    return SurfaceMaps(*(torch.zeros_like(x) for x in (like.mask, like.depth, like.normal)))


def pull_towards_truth(field: RawDensity, views: Crop, config: SurfaceConfig, draws: torch.Generator) -> Tensor:
    """How far points of some rays are on the wrong side of the iso value: the mean of solid ones, and of empty ones.

    On a ray that meets the object: a point a cell behind the true surface, which is to be solid, and one before it. On
    any other ray: two points in the box, which are to be empty.
    """
    rays = views.rays
    chosen = torch.randint(rays.origins[..., 0].numel(), (config.points,), generator=draws).to(rays.origins.device)
    entry, leave, cosine, depth = (x.flatten()[chosen] for x in (*rays.box_span(), views.cosine, views.truth.depth))
    hit = depth.isfinite() & (views.truth.mask.flatten()[chosen] > 0.5)
    surface = torch.where(hit, depth / cosine, leave)  # Along the ray.
    share = torch.rand(2, config.points, generator=draws).to(entry.device)
    before = entry + share * (torch.minimum(surface, leave) - entry).clamp(min=0.0)
    behind = torch.where(hit, surface + 2.0 / (config.grid - 1), before[1])
    distance = torch.stack([behind, before[0]])  # (2, points)
    origins, directions = (x.flatten(0, 1)[chosen] for x in (rays.origins, rays.directions))
    raw = field((origins + distance[..., None] * directions).clamp(-1.0, 1.0).flatten(0, 1)[None])
    solid = torch.stack([hit, torch.zeros_like(hit)]).flatten()
    wrong = torch.where(solid, -raw[0], raw[0]).clamp(min=0.0)
    inside, outside = ((wrong * side).sum() / side.sum().clamp(min=1) for side in (solid, ~solid))
    return inside + outside


@torch.no_grad()
def picture(model: GeoRM, sample: ViewSample, config: SurfaceConfig) -> Tensor:
    """The input views, the normals of the surface found, and the true ones."""
    encoded = encode(model, sample, 0.0, torch.Generator(), False)
    inputs = torch.arange(sample.inputs.images.shape[1])
    truth = view_samples.crop(sample, inputs, config.side, config.side, torch.Generator()).truth
    found = rendered(lambda points: model.occupancy_logit(encoded, points), sample, inputs, config) or nothing(truth)
    return grid([sample.inputs.images[0, :, :3], normals(found), normals(truth)], min(config.side, 256))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `python -m training fit georm-surface` takes."""
    rendered_views.add_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Train and write the averaged weights."""
    config = asked_for(args, TINY_SURFACE if args.preset == "tiny" else SurfaceConfig())
    return fit_georm(args, config, sample_loss, picture)
