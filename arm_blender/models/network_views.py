"""What networks take of posed views: squares of one size, composited, with their silhouettes."""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor
from torch.nn import functional as F

from ..graphics.borders import continued
from ..graphics.color import composite, srgb_from_linear
from ..graphics.visual_hull import Outlines, signed_silhouette_distance
from ..structures import ViewSet, stack_cameras


@dataclass(frozen=True)
class NetworkViews:
    """Views as the network takes them. B objects of V views each, square images of S pixels.

    Attributes:
        images: (B, V, 4, S, S): sRGB in [0, 1] composited on the background, then coverage.
        silhouette: (B, V, 2, H, H): coverage and signed silhouette distance in pixels, at the views' own resolution.
        c2w: (B, V, 4, 4).
        K: (B, V, 3, 3) pixels of an image of H.
        told: (B, V, 4) what of its square each view tells, as of `Outlines`.
        ground: height (Z) of what the object stands on, where that is known.
    """

    images: Tensor
    silhouette: Tensor
    c2w: Tensor
    K: Tensor
    told: Tensor | None = None
    ground: float | None = None

    @property
    def outlines(self) -> Outlines:
        """Of the views."""
        return Outlines(self.silhouette, self.c2w, self.K, self.told, self.ground)


class PictureConfig(Protocol):
    """What of a network's configuration pictures are made by."""

    @property
    def image_size(self) -> int:
        """Pixels a side of the network's input."""
        ...

    @property
    def background(self) -> float:
        """Grey level (sRGB) behind the object."""
        ...


def network_views(views: ViewSet, config: PictureConfig, silhouette_size: int = 320) -> NetworkViews:
    """One object's views as the network takes them, B = 1: padded to a square, composited, resized.

    Where a picture cuts the object it goes on as it ends, and tells nothing of what is there.

    Args:
        views: linear, straight alpha, of any size and shape; square pixels.
        config: of the network.
        silhouette_size: pixels a side of the silhouettes at most; smaller views keep their size.
    """
    images, (c2w, K) = views.images, stack_cameras(views.cameras)
    height, width = images.shape[-2:]
    side = max(height, width)
    left, top = (side - width) // 2, (side - height) // 2
    if height != width:
        images = F.pad(images, (left, side - width - left, top, side - height - top))
        K = K + K.new_tensor([[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]])
    moved = [(x + left, y + top, right + left, bottom + top) for x, y, right, bottom in views.rectangles]
    ended = [continued(image, known) for image, known in zip(images, moved, strict=True)]
    told = torch.stack([ends for _, ends in ended]).to(images.device)
    images = torch.stack([image for image, _ in ended])
    alpha = images[:, 3:]
    color = composite(srgb_from_linear(images[:, :3]), alpha, config.background)

    def resize(x: Tensor, size: int) -> Tensor:
        return (
            x
            if size == x.shape[-1]
            else F.interpolate(x, size=(size, size), mode="bicubic", antialias=True, align_corners=False).clamp(
                0.0, 1.0
            )
        )

    size = config.image_size
    fine = min(side, silhouette_size)
    coverage = resize(alpha, fine)
    silhouette = torch.cat([coverage, signed_silhouette_distance(coverage[:, 0]).unsqueeze(1)], dim=1)
    K = torch.cat([K[:, :2] * (fine / side), K[:, 2:]], dim=1)
    network = torch.cat([resize(color, size), resize(alpha, size)], dim=1)
    return NetworkViews(network[None], silhouette[None], c2w[None], K[None], told[None], views.ground)
