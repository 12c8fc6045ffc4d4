"""Distant light from an equirectangular picture: looked up by direction, sampled by brightness, and shaded with.

Directions follow Blender: the picture's centre is seen along +X, its left half along +Y, its top row along +Z. A turn
about Z moves what is seen along +X towards +Y.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import LUMINANCE
from .brdf import Form, evaluate

PAIRS_AT_ONCE = 1 << 20  # Of point and light: about 200 MB of work space.


@dataclass(frozen=True)
class Lights:
    """Light from L directions, in place of an integral over the sphere.

    Attributes:
        direction: (L, 3) unit, from the surface to the light, world.
        power: (L, 3) radiance times the solid angle that the direction stands for.
    """

    direction: Tensor
    power: Tensor


@dataclass(frozen=True)
class Environment:
    """Radiance from everywhere.

    Attributes:
        radiance: (3, H, W) linear Rec.709, finite and >= 0; row 0 is the zenith.
        turn: radians about Z, counter-clockwise seen from above.
    """

    radiance: Tensor
    turn: float = 0.0

    def __post_init__(self) -> None:
        if self.radiance.ndim != 3 or self.radiance.shape[0] != 3:
            raise ValueError(f"radiance (3, H, W) expected, got {tuple(self.radiance.shape)}")
        if not bool((self.radiance.isfinite() & (self.radiance >= 0.0)).all()):
            raise ValueError("radiance must be finite and not negative")

    def look_up(self, direction: Tensor) -> Tensor:
        """(P, 3) radiance along unit directions (P, 3), bilinear, closed around the vertical."""
        height, width = self.radiance.shape[1:]
        azimuth = torch.atan2(direction[:, 1], direction[:, 0]) - self.turn
        x = (0.5 - azimuth / (2.0 * math.pi)).remainder(1.0) * width
        y = (0.5 - torch.asin(direction[:, 2].clamp(-1.0, 1.0)) / math.pi) * height
        # One more column on each side: bilinear look-up then wraps around.
        closed = F.pad(self.radiance[None], (1, 1, 0, 0), mode="circular")
        grid = torch.stack([2.0 * (x + 1.0) / (width + 2) - 1.0, 2.0 * y / height - 1.0], dim=1)
        return F.grid_sample(closed, grid[None, None], padding_mode="border", align_corners=False)[0, :, 0].T

    def texels(self) -> Lights:
        """One light for each texel: exact for whatever changes little over a texel."""
        height, width = self.radiance.shape[1:]
        device = self.radiance.device
        y, x = torch.meshgrid(torch.arange(height, device=device), torch.arange(width, device=device), indexing="ij")
        direction = self._direction((x.flatten() + 0.5) / width, (y.flatten() + 0.5) / height)
        return Lights(direction, self.radiance.flatten(1).T * self._solid_angle().repeat_interleave(width)[:, None])

    def sample(self, count: int, seed: int = 0) -> Lights:
        """`count` lights drawn by luminance, stratified; sums over them are unbiased.

        No light has more luminance than the mean over all: a small sun is drawn often instead of shining bright, so
        that there are no fireflies to clamp.

        Raises:
            ValueError: the environment is black.
        """
        height, width = self.radiance.shape[1:]
        # Drawn on the CPU: a seed gives the same lights on every device.
        generator = torch.Generator().manual_seed(seed)
        random = torch.rand(3, count, generator=generator, dtype=torch.float64).to(self.radiance.device)
        solid_angle = self._solid_angle().repeat_interleave(width)
        power = self.radiance.flatten(1).T
        luminance = (power @ power.new_tensor(LUMINANCE)).double() * solid_angle
        total = luminance.sum()
        if not float(total) > 0.0:
            raise ValueError("a black environment has no light to draw")
        place = (torch.arange(count, device=random.device) + random[0]) / count
        texel = torch.searchsorted(luminance.cumsum(0) / total, place, right=True).clamp(max=height * width - 1)
        across, down = random[1:]
        row = torch.div(texel, width, rounding_mode="floor")
        # Uniform in solid angle within the texel: in the sine of the elevation, not in the elevation.
        top, bottom = (math.pi * row / height).cos(), (math.pi * (row + 1) / height).cos()
        y = (top + down * (bottom - top)).acos() / math.pi
        direction = self._direction((texel % width + across) / width, y)
        share = luminance[texel] / total * count
        return Lights(direction.to(power), power[texel] * (solid_angle[texel] / share)[:, None].to(power))

    def _direction(self, x: Tensor, y: Tensor) -> Tensor:
        """(P, 3) unit direction at (P,) shares of the width and the height."""
        azimuth, polar = math.pi * (1.0 - 2.0 * x) + self.turn, math.pi * y
        return torch.stack([polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()], dim=1)

    def _solid_angle(self) -> Tensor:
        """(H,) steradians of a texel of each row."""
        height, width = self.radiance.shape[1:]
        edges = (math.pi * torch.arange(height + 1, device=self.radiance.device) / height).cos()
        return (edges[:-1] - edges[1:]) * (2.0 * math.pi / width)


def shade(
    normal: Tensor,
    view: Tensor,
    albedo: Tensor,
    roughness: Tensor,
    metallic: Tensor,
    lights: Lights,
    visible: Tensor | None = None,
    form: Form = "standard",
) -> Tensor:
    """Direct light that points send to the camera (ARM, equation 1).

    Args:
        normal: (P, 3) unit. view: (P, 3) unit, to the camera. albedo: (P, 3). roughness, metallic: (P, 1).
        lights: whose sum stands for the integral.
        visible: (P, L) share of each light that reaches each point; all of it by default.
        form: of the BRDF.
    Returns:
        (P, 3) radiance.
    """
    parts = []
    step = max(1, PAIRS_AT_ONCE // max(1, len(lights.direction)))
    for first in range(0, len(normal), step):
        chunk = slice(first, first + step)
        here = (x[chunk, None] for x in (normal, view, albedo, roughness, metallic))
        n, v, a, r, m = here
        cosine = (n * lights.direction).sum(dim=-1, keepdim=True).clamp(min=0.0)
        arriving = cosine * lights.power
        if visible is not None:
            arriving = arriving * visible[chunk, :, None]
        parts.append((evaluate(n, lights.direction, v, a, r, m, form) * arriving).sum(dim=1))
    return torch.cat(parts) if parts else normal.new_zeros(0, 3)
