"""What posed views tell of a shape: how far their pixels lie from the outline, and blurred colours to compare."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from ..graphics.borders import continued
from ..graphics.cameras import Camera, project
from ..graphics.color import composite, srgb_from_linear
from ..graphics.visual_hull import signed_silhouette_distance
from ..structures import ViewSet

OUTLINE_PIXEL, MOST_DOUBLED = 0.005, 2.0
"""World units of a pixel in which outlines are measured; and how many times finer than its picture at most."""

COLOR_PIXEL = 0.02
"""World units of a pixel in which colours are compared: finer ones made the shape worse, as noise agrees with noise."""

GREY = 0.5
"""sRGB behind the object where colours are compared."""

REACH = 24
"""Fine pixels up to which the distance to an outline is exact."""


@dataclass(frozen=True)
class PictureEvidence:
    """One view as the refinement reads it.

    Attributes:
        outline_camera: of the pixels that outlines are measured in, h x w of them.
        distance: (h, w) to the outline in those pixels, positive inside.
        slope: (2, h, w) its derivatives to the right and downwards.
        told: (4,) left, top, right and bottom of what the picture tells, in the same pixels.
        color_camera: of the pixels that colours are compared in.
        color: (4, H, W) sRGB over grey, then coverage.
        doubled: fine pixels along one of the picture's own.
    """

    outline_camera: Camera
    distance: Tensor
    slope: Tensor
    told: Tensor
    color_camera: Camera
    color: Tensor
    doubled: float

    def tells(self, pixels: Tensor) -> Tensor:
        """(P,) bool: whether the picture tells of the places (P, 2) in pixels of the outline."""
        return ((pixels >= self.told[:2]) & (pixels <= self.told[2:])).all(dim=1)

    def at_outline(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Of world points (P, 3): signed distance to the outline (P,), its slope (P, 2), and depth (P,).

        The distance is 0 where the picture tells nothing.
        """
        pixels, depth = project(points, self.outline_camera)
        size = self.outline_camera.width, self.outline_camera.height
        found = sampled(torch.cat([self.distance[None], self.slope]), pixels, size)
        told = self.tells(pixels) & (depth > 0.0)
        return torch.where(told, found[:, 0], 0.0), found[:, 1:], depth


def evidence(views: ViewSet) -> list[PictureEvidence]:
    """Of every view of normalised `views`."""
    found = []
    for picture, camera, known in zip(views.images, views.cameras, views.rectangles, strict=True):
        picture, told = continued(picture, known)
        alpha = picture[3:]
        color = torch.cat([composite(srgb_from_linear(picture[:3]), alpha, GREY), alpha])
        pixel = float((camera.c2w[:3, 2] * camera.center).sum().abs() / camera.K[0, 0])
        outline_camera = _scaled(camera, min(pixel / OUTLINE_PIXEL, MOST_DOUBLED))
        color_camera = _scaled(camera, min(pixel / COLOR_PIXEL, 1.0))
        coverage = _resized(alpha, outline_camera)
        distance = signed_silhouette_distance(coverage, REACH)[0].clamp(-REACH, REACH)
        down, right = torch.gradient(distance)
        size = torch.tensor([outline_camera.width, outline_camera.height] * 2)
        box = ((told + 1.0) / 2.0 * size).to(alpha.device)
        seen = _resized(color, color_camera)
        found.append(
            PictureEvidence(
                outline_camera,
                distance,
                torch.stack([right, down]),
                box,
                color_camera,
                seen,
                outline_camera.width / camera.width,
            )
        )
    return found


def sampled(maps: Tensor, pixels: Tensor, size: tuple[int, int]) -> Tensor:
    """(P, C) of maps (C, h, w), bilinear, at places (P, 2) in pixels of a picture of `size` (width, height)."""
    grid = (2.0 * pixels / pixels.new_tensor(size) - 1.0)[None, None]
    return F.grid_sample(maps[None], grid, padding_mode="border", align_corners=False)[0, :, 0].T


def _scaled(camera: Camera, factor: float) -> Camera:
    return camera.resized(max(8, round(camera.width * factor)), max(8, round(camera.height * factor)))


def _resized(maps: Tensor, camera: Camera) -> Tensor:
    """(C, H, W) maps in [0, 1] with the pixels of `camera`."""
    size = camera.height, camera.width
    return F.interpolate(maps[None], size=size, mode="bicubic", antialias=True, align_corners=False)[0].clamp(0.0, 1.0)
