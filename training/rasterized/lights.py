"""Light for pictures that are rasterised: an environment, prefiltered, and suns that cast sharp shadows.

An environment is kept twice: as the irradiance that each cone of `rasterized_surface.directions` brings, for surfaces
that scatter light, and convolved with GGX lobes of growing roughness (Karis 2013), for those that mirror it.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import OpenImageIO as oiio
import torch
from torch import Tensor
from torch.nn import functional

from arm_blender.errors import ArmError
from arm_blender.graphics.color import LUMINANCE
from arm_blender.graphics.light.brdf import distribution
from arm_blender.graphics.light.environment import Environment

from ..random_numbers import uniform
from .surface import DIRECTIONS, directions

HEIGHT, WIDTH = 64, 128
"""Texels of an environment: 2.8° each."""
ROUGHNESSES = (0.08, 0.2, 0.32, 0.45, 0.65, 1.0)
"""At which the environment is convolved; between them it is interpolated."""
SUN_SHARE = 0.1
"""Of all light: what comes from around the brightest texel is a sun if it is more."""


@dataclass(frozen=True)
class Sun:
    """A small distant light.

    Attributes:
        direction: (3,) unit, towards the light, world.
        power: (3,) irradiance of a surface that faces it.
        radius: radians; the half shadow is twice as wide.
    """

    direction: Tensor
    power: Tensor
    radius: float


@dataclass(frozen=True)
class Lighting:
    """All light of a scene.

    Attributes:
        cones: (D, 3, 3) irradiance by direction of the sky: world axes by colour. Its product with a normal is what the
            cone brings to a surface that sees all of it.
        levels: (3, L, HEIGHT, WIDTH + 2) radiance, convolved for each of `ROUGHNESSES`; a column more on each side.
        suns: what is not in the environment.
    """

    cones: Tensor
    levels: Tensor
    suns: tuple[Sun, ...]


def read_radiance(path: Path) -> Tensor:
    """(3, HEIGHT, WIDTH) of an equirectangular .hdr or .exr, at a mean luminance of 1 over the sphere.

    Raises:
        ArmError: the file cannot be read, or is black.
    """
    buffer = oiio.ImageBuf(str(path))
    if not buffer.initialized or buffer.has_error:
        raise ArmError(f"{path}: not a readable environment map; give .hdr or .exr files")
    pixels = torch.from_numpy(buffer.get_pixels(oiio.FLOAT)).permute(2, 0, 1)[:3]
    radiance = functional.interpolate(pixels[None].nan_to_num(0.0).clamp(0.0, 1e5), size=(HEIGHT, WIDTH), mode="area")
    mean = float(_luminance(Environment(radiance[0]).texels().power).sum()) / (4.0 * math.pi)
    if not mean > 0.0:
        raise ArmError(f"{path}: a black environment map; remove it")
    return radiance[0] / mean


def random_lighting(maps: Sequence[Tensor], generator: torch.Generator) -> Lighting:
    """Random light, made ready; arguments as of `random_sky`."""
    return lighting(*random_sky(maps, generator))


def random_sky(maps: Sequence[Tensor], generator: torch.Generator) -> tuple[Tensor, tuple[Sun, ...]]:
    """One of the environments, or one made of a sky and soft boxes, turned; and perhaps a sun or two.

    Args:
        maps: of `read_radiance`; may be empty.
    Returns:
        (3, HEIGHT, WIDTH) radiance, and suns beside it.
    """
    # A third of the light is made: studios with area lights are rare among photographed environments.
    choice = int(torch.randint(len(maps) + max(1, len(maps) // 2), (), generator=generator))
    radiance = maps[choice] if choice < len(maps) else studio(generator)
    radiance = radiance.roll(int(torch.randint(WIDTH, (), generator=generator)), dims=2)
    exposure, odds = 0.6 + 0.8 * uniform(generator), uniform(generator)
    suns = tuple(_random_sun(generator) for _ in range(int(odds > 0.6) + int(odds > 0.9)))
    # Ambient light gives way to suns, so that pictures stay about as bright.
    return radiance * (exposure / (1.0 + 0.7 * len(suns))), suns


def lighting(radiance: Tensor, suns: tuple[Sun, ...] = ()) -> Lighting:
    """An environment (3, HEIGHT, WIDTH) made ready; the sun in it, if it has one, casts sharp shadows.

    Raises:
        ValueError: another size.
    """
    if radiance.shape != (3, HEIGHT, WIDTH):
        raise ValueError(f"radiance {tuple(radiance.shape)}, expected {(3, HEIGHT, WIDTH)}")
    radiance, own = _without_sun(radiance)
    lights = Environment(radiance).texels()
    brought = lights.direction[:, :, None] * lights.power[:, None, :]  # (texels, 3 axes, 3 colours)
    cones = torch.zeros(DIRECTIONS, 3, 3).index_add_(0, _cone_of_texel(), brought)
    return Lighting(cones, _convolved(radiance), own + suns)


def studio(generator: torch.Generator) -> Tensor:
    """(3, HEIGHT, WIDTH): a dim room, brighter above or below, with one to five soft boxes; mean luminance 1."""
    direction = _texel_directions()  # (3, H, W)
    ends = 0.05 + 0.5 * torch.rand(2, 1, generator=generator) * _tint(2, generator)
    height = 0.5 + 0.5 * direction[2]
    radiance = ends[0, :, None, None] * height + ends[1, :, None, None] * (1.0 - height)
    for _ in range(1 + int(torch.randint(5, (), generator=generator))):
        middle = _upward(generator)
        side = functional.normalize(torch.linalg.cross(middle, torch.randn(3, generator=generator)), dim=0)
        up = torch.linalg.cross(middle, side)
        x, y, z = (torch.einsum("i,ihw->hw", axis, direction) for axis in (side, up, middle))
        extent = 0.1 + 0.5 * torch.rand(2, generator=generator)
        inside = (z > 0.0) & (x.abs() < extent[0] * z) & (y.abs() < extent[1] * z)
        power = (4.0 + 20.0 * uniform(generator)) * _tint(1, generator)[0]
        radiance = radiance + inside * power[:, None, None]
    mean = _luminance(Environment(radiance).texels().power).sum() / (4.0 * math.pi)
    return radiance / mean


def mirrored(levels: Tensor, direction: Tensor, roughness: Tensor) -> Tensor:
    """(P, 3) radiance around directions (P, 3), as wide as a lobe of roughness (P, 1) is."""
    known = torch.tensor(ROUGHNESSES)
    rough = roughness[:, 0].clamp(known[0], known[-1])
    upper = torch.searchsorted(known, rough).clamp(1, len(known) - 1)
    level = upper - 1 + (rough - known[upper - 1]) / (known[upper] - known[upper - 1])
    x = (0.5 - torch.atan2(direction[:, 1], direction[:, 0]) / (2.0 * math.pi)) * WIDTH + 1.0
    y = (0.5 - torch.asin(direction[:, 2].clamp(-1.0, 1.0)) / math.pi) * HEIGHT
    grid = torch.stack([
        2.0 * x / (WIDTH + 2) - 1.0, 2.0 * y / HEIGHT - 1.0, (2.0 * level + 1.0) / len(known) - 1.0
    ], dim=1)  # fmt: skip
    found = functional.grid_sample(levels[None], grid.view(1, 1, 1, -1, 3), padding_mode="border", align_corners=False)
    return found[0, :, 0, 0].T


def _convolved(radiance: Tensor) -> Tensor:
    """(3, L, HEIGHT, WIDTH + 2): a lobe is the same all around the vertical, so rows are convolved as circles."""
    spectrum = torch.fft.rfft(radiance, dim=2)  # (3, HEIGHT, WIDTH / 2 + 1)
    levels = torch.fft.irfft(torch.einsum("loik,cik->clok", _lobes(), spectrum), n=WIDTH, dim=3)
    # The transform's rounding may fall below 0 where almost nothing is.
    return functional.pad(levels.clamp(min=0.0), (1, 1, 0, 0), mode="circular")


@functools.cache
def _lobes() -> Tensor:
    """(L, rows out, rows in, WIDTH / 2 + 1) spectra around the vertical of lobes that look along their normal.

    Light l counts D(n.h) (n.l) / 4, the density by which halves of l and n are drawn, times the cosine (Karis 2013).
    """
    direction = _texel_directions()  # (3, H, W)
    first = direction[:, :, 0]  # (3, H): of each row one normal
    n_dot_l = torch.einsum("io,ihw->ohw", first, direction).clamp(0.0, 1.0)  # (rows out, rows in, W)
    area = Environment(torch.ones(3, HEIGHT, WIDTH)).texels().power[:, 0].view(HEIGHT, WIDTH)
    gap = 1.0 - (0.5 + 0.5 * n_dot_l).sqrt()
    spectra = []
    for roughness in ROUGHNESSES:
        kernel = distribution(gap, torch.tensor(roughness)) * n_dot_l * area
        kernel = kernel / kernel.sum(dim=(1, 2), keepdim=True)
        spectra.append(torch.fft.rfft(kernel, dim=2))
    return torch.stack(spectra)


def _without_sun(radiance: Tensor) -> tuple[Tensor, tuple[Sun, ...]]:
    """The environment without its brightest spot, and that as a sun, where it is a large share of all light."""
    lights = Environment(radiance).texels()
    luminance, total = _luminance(radiance).flatten(), _luminance(lights.power).sum()
    middle = lights.direction[luminance.argmax()]
    around = lights.direction @ middle > math.cos(math.radians(8.0))
    near = lights.direction @ middle > math.cos(math.radians(16.0))
    background = radiance.flatten(1)[:, near & ~around].mean(dim=1)
    bright = around & (luminance > 4.0 * _luminance(background) + 1e-6)
    beyond = (lights.power - background * (lights.power / radiance.flatten(1).T.clamp(min=1e-9))) * bright[:, None]
    power = beyond.clamp(min=0.0).sum(dim=0)
    if _luminance(power) <= SUN_SHARE * total:
        return radiance, ()
    share = _luminance(beyond.clamp(min=0.0))
    direction = functional.normalize((share[:, None] * lights.direction).sum(dim=0), dim=0)
    spread = float((share * torch.acos((lights.direction @ direction).clamp(-1.0, 1.0))).sum() / share.sum())
    dark = torch.where(bright, torch.minimum(radiance.flatten(1), background[:, None]), radiance.flatten(1))
    return dark.view_as(radiance), (Sun(direction, power, max(spread, 0.005)),)


def _random_sun(generator: torch.Generator) -> Sun:
    power = (0.8 + 2.7 * uniform(generator)) * _tint(1, generator)[0]
    return Sun(_upward(generator), power, 0.005 + 0.2 * uniform(generator) ** 2)


def _upward(generator: torch.Generator) -> Tensor:
    """(3,) unit: lights hang above more often than not."""
    direction = functional.normalize(torch.randn(3, generator=generator), dim=0)
    return direction if direction[2] > -0.3 else -direction


def _tint(count: int, generator: torch.Generator) -> Tensor:
    """(count, 3) warm to cold whites."""
    warm = torch.rand(count, 1, generator=generator) - 0.5
    return 1.0 + warm * torch.tensor([0.5, 0.05, -0.5])


@functools.cache
def _texel_directions() -> Tensor:
    return Environment(torch.zeros(3, HEIGHT, WIDTH)).texels().direction.T.reshape(3, HEIGHT, WIDTH)


@functools.cache
def _cone_of_texel() -> Tensor:
    return (_texel_directions().flatten(1).T @ directions().T).argmax(dim=1)


def _luminance(color: Tensor) -> Tensor:
    """Of (..., 3), or of a picture (3, H, W)."""
    weights = color.new_tensor(LUMINANCE)
    return torch.einsum("i,ihw->hw", weights, color) if color.ndim == 3 else color @ weights
