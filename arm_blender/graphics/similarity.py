"""The similarity that brings points onto others (Umeyama 1991)."""

import torch
from torch import Tensor


def similarity(source: Tensor, target: Tensor) -> tuple[float, Tensor, Tensor]:
    """Scale, rotation (3, 3) and shift (3,) that bring points (P, 3) nearest to others; points in one place only move.

    Where the points lie in a plane or on a line it is still a rotation, never a reflection.
    """
    center, aim = source.mean(dim=0), target.mean(dim=0)
    a, b = source - center, target - aim
    u, stretch, vt = torch.linalg.svd(b.T @ a)
    sign = torch.ones_like(stretch)
    sign[2] = torch.sign(torch.linalg.det(u) * torch.linalg.det(vt))
    rotation = (u * sign) @ vt
    spread = float(a.square().sum())
    scale = max(float((stretch * sign).sum()) / spread, 1e-6) if spread > 1e-12 else 1.0
    return scale, rotation, aim - scale * rotation @ center
