"""A red ball on a patterned ground with a shadow, photographed by cameras that expose differently; in closed form."""

import math

import torch
from torch import Tensor

from arm_blender.graphics.cameras import look_at
from arm_blender.photographs.capture import Lens
from arm_blender.photographs.masks.eyes import Eye

WIDTH, HEIGHT = 160, 120
LENS = Lens("SIMPLE_RADIAL", (140.0, 80.0, 60.0, 0.02), WIDTH, HEIGHT)
RADIUS, GROUND = 1.0, -1.0
SHADOW = (1.4, 0.3, 0.7)
"""Middle and radius on the ground."""


def eyes(count: int = 12, lens: Lens = LENS) -> list[Eye]:
    """Two rings around the origin."""
    found = []
    for k in range(count):
        azimuth, elevation = 2.0 * math.pi * k / count, math.radians(20.0 if k % 3 else 45.0)
        flat = 4.5 * math.cos(elevation)
        place = torch.tensor([flat * math.sin(azimuth), -flat * math.cos(azimuth), 4.5 * math.sin(elevation)])
        c2w = look_at(place, torch.tensor([0.1 * math.sin(3.0 * k), 0.1, 0.0])).double()
        found.append(Eye(torch.linalg.inv(c2w @ torch.diag(c2w.new_tensor([1.0, -1.0, -1.0, 1.0]))), lens))
    return found


def photograph(eye: Eye, gain: float = 1.0) -> tuple[Tensor, Tensor, Tensor]:
    """(3, H, W) sRGB, (H, W) bool where the ball is, and where the shadow is."""
    x, y = (2.0 * (torch.arange(size) + 0.5) / size - 1.0 for size in (WIDTH, HEIGHT))
    ray, center = eye.rays(torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)), eye.center.float()
    along = -(ray @ center)
    ball = (center.square().sum() - along.square()) < RADIUS**2
    down = (GROUND - center[2]) / ray[..., 2]
    spot = center + down[..., None] * ray
    on_it = (down > 0.0) & (spot[..., :2].abs().amax(dim=-1) < 20.0)
    shadow = on_it & ((spot[..., :2] - torch.tensor(SHADOW[:2])).norm(dim=-1) < SHADOW[2]) & ~ball
    pattern = pattern_of(spot) * torch.where(shadow, 0.4, 1.0)
    color = torch.where(on_it, pattern, torch.tensor([0.5, 0.6, 0.8])[:, None, None])
    # A ball with stripes of its own: it does not look like anything that lies still on the ground.
    stripes = 0.5 + 0.3 * torch.sin(9.0 * (center + along[..., None] * ray)[..., 2])
    color = torch.where(ball, torch.stack([stripes + 0.2, 0.2 * stripes, 0.2 * stripes]), color)
    return (color * gain).clamp(0.0, 1.0), ball, shadow


def pattern_of(points: Tensor) -> Tensor:
    """(3, ...) the ground's own colour at points (..., 3)."""
    x, y = points[..., 0], points[..., 1]
    wave = torch.sin(2.0 * x) * torch.cos(1.7 * y)
    return torch.stack([0.45 + 0.15 * wave, 0.5 - 0.1 * wave, 0.35 + 0.1 * torch.sin(x + y)])
