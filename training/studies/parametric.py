"""Surfaces that any machine can make, with an atlas: what pictures are compared on where no data are at hand."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from arm_blender.structures import UvMesh


def parametric(point: Callable[[Tensor, Tensor], Tensor], columns: int, rows: int) -> UvMesh:
    """A surface over the unit square, closed in the first coordinate where its ends meet.

    Args:
        point: (P,), (P,) in [0, 1] -> (P, 3) world; counter-clockwise seen from outside.
    """
    v, u = torch.meshgrid(torch.linspace(0, 1, rows + 1), torch.linspace(0, 1, columns + 1), indexing="ij")
    uvs = torch.stack([u.flatten(), v.flatten()], dim=1)
    row, column = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    a = (row * (columns + 1) + column).flatten()
    corners = torch.cat([
        torch.stack([a, a + 1, a + columns + 2], 1), torch.stack([a, a + columns + 2, a + columns + 1], 1)
    ])  # fmt: skip
    # One vertex where the surface meets itself, so that it is smooth there.
    keys = (point(uvs[:, 0], uvs[:, 1]) * 1e5).round()
    distinct, index = torch.unique(keys, dim=0, return_inverse=True)
    faces = index[corners]
    whole = (faces != faces.roll(1, dims=1)).all(dim=1)
    return UvMesh(distinct / 1e5, faces[whole], uvs, corners[whole], 1)


def ball(u: Tensor, v: Tensor) -> Tensor:
    """(P, 3) of radius 0.9."""
    azimuth, polar = 2.0 * math.pi * u, math.pi * (1.0 - v)
    return 0.9 * torch.stack([polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()], dim=1)


def ring(u: Tensor, v: Tensor) -> Tensor:
    """(P, 3) of a torus about Z, which hides light from itself in its hole."""
    along, around = 2.0 * math.pi * u, 2.0 * math.pi * v
    radius = 0.62 + 0.28 * around.cos()
    return torch.stack([radius * along.cos(), radius * along.sin(), 0.28 * around.sin()], dim=1)


def vase(u: Tensor, v: Tensor) -> Tensor:
    """A body of revolution with a foot, a belly and a neck that shadow each other."""
    angle, height = 2.0 * math.pi * u, 1.8 * v - 0.9
    radius = 0.32 + 0.2 * (4.2 * height + 0.4).sin() + 0.18 * (0.5 - v)
    closed = (math.pi * v).sin().clamp(min=0.0) ** 0.25
    radius = radius * closed
    return torch.stack([radius * angle.cos(), radius * angle.sin(), height], dim=1)
