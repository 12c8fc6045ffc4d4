"""Points under other light and in other paint, and nothing rendered: the light of a sample is fitted, and exchanged.

What a colour is besides albedo times fitted irradiance (shadows, reflections, what lies askew) it stays.
"""

import math
from dataclasses import replace

import torch
from torch import Tensor

from arm_blender.graphics.color import LUMINANCE
from arm_blender.graphics.light.environment import Environment
from arm_blender.graphics.light.harmonic_light import harmonics_of
from arm_blender.graphics.light.spherical_harmonics import COUNT, WHITE, gathered
from arm_blender.models.small.delighting import REFLECTED, SeenPoints

from ..random_numbers import uniform
from ..rasterized.lights import studio
from ..rasterized.pictures import Library
from .delighting_samples import DelightingSample
from .point_samples import rotation_z

RELIT, REPAINTED = 0.6, 0.65
"""Shares of the samples."""

ALONE, FEW = 0.12, 0.25
"""Shares of the samples that one view sees, and that one or half of the views see."""

EXPOSURE, SPREAD = 0.8, 0.1
"""Mean luminance of light, and the deviation of its logarithm. From pictures alone nobody can tell a dim light from a
dark object, so that the network takes their exposure for a usual one. Trained on exposures from 0.6 to 1.4, it lost 2
dB of albedo where they were usual."""

MOST_EXPOSED, LEAST_EXPOSED = 1.6, 0.5
"""Factors by which a sample is brought to `EXPOSURE` at most: what was clipped stays so."""

DARKEST = 0.03
"""Least factor of half of the new paints, evenly drawn in its logarithm: black things are common, and hardest to tell
from grey ones that reflect."""

STIFF = 1e-3
"""Weight of the white light that the fitted one is drawn to, by ridge regression: some directions no point faces."""


def random_light(library: Library, random: torch.Generator) -> Tensor:
    """(9, 3) harmonics of an environment or of a made studio, turned; now and then two of them mixed."""

    def one() -> Tensor:
        if library.environments and uniform(random) < 0.75:
            radiance = library.environments[int(torch.randint(len(library.environments), (), generator=random))]
        else:
            radiance = studio(random)
        return harmonics_of(Environment(radiance, turn=2.0 * math.pi * uniform(random)))

    light = one()
    if uniform(random) < 0.3:
        light = torch.lerp(one(), light, uniform(random))
    return light * usual_exposure(random)


def usual_exposure(random: torch.Generator) -> float:
    """Around `EXPOSURE`."""
    return EXPOSURE * math.exp(SPREAD * float(torch.randn((), generator=random)))


def exposed(sample: DelightingSample) -> DelightingSample:
    """The sample at `EXPOSURE`, by the luminance of the light that was fitted."""
    luminance = float(fitted_light(sample)[0] @ torch.tensor(LUMINANCE)) / WHITE
    factor = min(max(EXPOSURE / max(luminance, 1e-3), LEAST_EXPOSED), MOST_EXPOSED)
    return _brighter(sample, factor)


def fitted_light(sample: DelightingSample) -> Tensor:
    """(9, 3) harmonics of the light under which the albedo, and what it reflects, come nearest to the colours."""
    basis, color, albedo = gathered(sample.points.normal[0]), sample.points.blended()[0], sample.albedo[0]
    weight = STIFF * len(basis) * torch.tensor([0.01] + [0.1] * (COUNT - 1))
    plain = torch.tensor([WHITE] + [0.0] * (COUNT - 1))
    lights = []
    for channel in range(3):
        sent = basis * (albedo[:, channel, None] + REFLECTED)
        square = sent.T @ sent + torch.diag(weight)
        lights.append(torch.linalg.solve(square, sent.T @ color[:, channel] + weight * plain))
    return torch.stack(lights, dim=1)


def augmented(
    sample: DelightingSample, light: Tensor, count: int, library: Library, random: torch.Generator
) -> DelightingSample:
    """`count` points of an `exposed` sample, turned, perhaps mirrored, relit, repainted, seen by fewer views.

    Args:
        light: the sample's, as of `fitted_light`; it is the same in every step.
    """
    chosen = torch.randint(sample.albedo.shape[1], (count,), generator=random)
    sample = replace(sample, points=sample.points.only(chosen), albedo=sample.albedo[:, chosen])
    if uniform(random) < REPAINTED:
        sample = repainted(sample, light, random)
    if uniform(random) < RELIT:
        sample = relit(sample, light, random_light(library, random))
    else:
        sample = _brighter(sample, usual_exposure(random) / EXPOSURE)
    points = fewer_views(sample.points, random)
    turn = rotation_z(2.0 * math.pi * uniform(random))
    if uniform(random) < 0.5:
        turn = turn @ torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    turned = {name: getattr(points, name) @ turn.T for name in ("position", "normal", "eyes")}
    return replace(sample, points=replace(points, **turned))


def relit(sample: DelightingSample, old: Tensor, new: Tensor) -> DelightingSample:
    """The sample under another light; lights (9, 3), clipped as a picture is."""
    basis = gathered(sample.points.normal)
    factor = ((basis @ new).clamp(min=0.03) / (basis @ old).clamp(min=0.08)).clamp(max=6.0)
    color = (sample.points.color * factor[:, None]).clamp(max=1.0)
    return replace(sample, points=replace(sample.points, color=color))


def repainted(sample: DelightingSample, light: Tensor, random: torch.Generator) -> DelightingSample:
    """The sample in another paint under its own light (9, 3): contrast, hues, tint. What it reflects stays."""
    paint = sample.albedo.clamp(min=1e-4) ** (0.7 + 0.8 * uniform(random))
    if uniform(random) < 0.6:
        paint = paint[..., torch.randperm(3, generator=random)]
    tint = (0.25 * torch.randn(3, generator=random)).exp()
    if uniform(random) < 0.5:
        tint = tint * DARKEST ** uniform(random)
    else:
        brightest = float(paint.flatten().quantile(0.95))
        tint = tint * (0.6 + 0.4 * uniform(random)) / max(brightest, 0.2)
    paint = (paint * tint).clamp(1e-5, 0.95)
    irradiance = (gathered(sample.points.normal) @ light).clamp(min=0.0)
    more = (paint - sample.albedo) * irradiance
    color = (sample.points.color + more[:, None]).clamp(1e-4, 1.0)
    return replace(sample, points=replace(sample.points, color=color), albedo=paint)


def fewer_views(points: SeenPoints, random: torch.Generator) -> SeenPoints:
    """As if some views did not see a thing, unless too little would be left."""
    views, odds = points.visible.shape[1], uniform(random)
    keep = torch.ones(views, dtype=torch.bool)
    if odds < FEW:
        keep = torch.rand(views, generator=random) < 0.5
    if odds < ALONE:
        keep = torch.arange(views) == int(torch.randint(views, (), generator=random))
    visible = points.visible & keep[:, None]
    if float(visible.any(dim=1).float().mean()) < 0.15:
        return points
    return replace(points, visible=visible)


def _brighter(sample: DelightingSample, factor: float) -> DelightingSample:
    color = (sample.points.color * factor).clamp(max=1.0)
    return replace(sample, points=replace(sample.points, color=color))
