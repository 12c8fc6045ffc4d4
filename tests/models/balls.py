"""Views of a ball in closed form, and points to ask networks at."""

import math

import torch

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.structures import ViewSet


def ball_views(radius: float, size: int = 64, distance: float = 4.0, views: int = 6) -> ViewSet:
    """Six views of a ball around the origin: its silhouette is a disc, by the tangent cone's half angle."""
    cameras = tuple(orbit_camera(60 * i, (20, -10)[i % 2], distance, 40, size, size) for i in range(views))
    disc = float(cameras[0].K[0, 0]) * math.tan(math.asin(radius / distance))
    centers = torch.arange(size) + 0.5 - size / 2
    alpha = (centers[:, None] ** 2 + centers[None] ** 2 <= disc**2).float()
    images = torch.cat([torch.full((3, size, size), 0.4), alpha[None]]).expand(views, -1, -1, -1)
    return ViewSet(images, cameras, torch.ones(views), "ball")


def points(count: int) -> torch.Tensor:
    return torch.rand(1, count, 3, generator=torch.Generator().manual_seed(3)) * 2 - 1
