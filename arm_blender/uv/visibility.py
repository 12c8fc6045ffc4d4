"""Which surface points a camera sees: a z-buffer of the mesh itself, with room for a mesh that is a pixel off."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..graphics.cameras import Camera, project
from ..graphics.raster.rasterize import rasterize
from ..graphics.windows import highest_around, lowest_around
from ..structures import TriangleMesh, UvMesh


@dataclass(frozen=True)
class DepthBuffer:
    """The z-buffer of a mesh, and what it says of the neighbourhood of each pixel.

    Attributes:
        camera: of the buffer.
        radius: pixels of the buffer by which an outline may be off.
        depth: (H, W) along the view axis, world units; infinity is background.
        nearest: (H, W) the least depth within the radius.
        deepest: (H, W) the largest there that is not background; minus infinity where all is.
    """

    camera: Camera
    radius: int
    depth: Tensor
    nearest: Tensor
    deepest: Tensor

    @classmethod
    def of(cls, mesh: TriangleMesh | UvMesh, camera: Camera, resolution: int, margin: float) -> "DepthBuffer":
        """Drawn with `resolution` pixels on its longer side; `margin` is the radius in pixels of `camera`."""
        scale = resolution / max(camera.width, camera.height)
        sized = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
        radius = math.ceil(margin * sized.height / camera.height - 1e-3)
        depth = rasterize(mesh.vertices, mesh.faces, sized).depth
        # Against the background it is the picture's alpha that tells the outline.
        deepest = highest_around(torch.where(torch.isinf(depth), -torch.inf, depth), radius)
        return cls(sized, radius, depth, lowest_around(depth, radius), deepest)


def unoccluded(
    points: Tensor, normals: Tensor, buffer: DepthBuffer, depth_bias: float, slope_bias: float, min_cosine: float
) -> tuple[Tensor, Tensor]:
    """Points that nothing hides, and those of them that also keep their distance from an edge of their own surface.

    Whatever is hidden anywhere within the buffer's radius is hidden.

    Args:
        points: (P, 3) world.
        normals: (P, 3) unit.
        buffer: of what may hide them.
        depth_bias: world units.
        slope_bias: pixels of the buffer over which a slanted surface may fall or rise besides.
        min_cosine: a surface more slanted than this gets no more bias than at this.
    Returns:
        (P,) bool unoccluded, (P,) bool unoccluded and away from where the surface breaks off before a deeper one.
    """
    height, width = buffer.depth.shape
    where, depth = project(points, buffer.camera)
    inside = (depth > 0) & (where >= 0).all(dim=1) & (where[:, 0] < width) & (where[:, 1] < height)
    column, row = where[:, 0].long().clamp(0, width - 1), where[:, 1].long().clamp(0, height - 1)
    pixel = row * width + column
    slope = _slope(points, normals, buffer.camera, min_cosine)
    here, around = depth_bias + slope_bias * slope, depth_bias + (buffer.radius + slope_bias) * slope
    # The wide window needs so much bias that by itself it would let through what lies closely behind.
    free = inside & (depth <= buffer.depth.take(pixel) + here) & (depth <= buffer.nearest.take(pixel) + around)
    return free, free & (buffer.deepest.take(pixel) <= depth + around)


def _slope(points: Tensor, normals: Tensor, camera: Camera, min_cosine: float) -> Tensor:
    """(P,) how much the tangent plane's depth changes at most over a pixel aside and a pixel up or down, world units.

    The plane n.p = const meets the ray z d at z = const / (n.d), so dz/dx = -z n_x / (f n.d).
    """
    axes = camera.w2c[:3, :3].T
    local, normal = points @ axes + camera.w2c[:3, 3], normals @ axes
    depth = -local[:, 2].clamp(max=-1e-6)
    ray = local / depth[:, None]
    facing = torch.maximum((normal * ray).sum(dim=1).abs(), min_cosine * ray.norm(dim=1))
    return depth * (normal[:, 0].abs() / camera.K[0, 0] + normal[:, 1].abs() / camera.K[1, 1]) / facing


def opaque_pixels(alpha: Tensor, threshold: float, radius: int) -> Tensor:
    """(H, W) bool: pixels of at least `threshold` alpha without a lesser one within `radius` pixels."""
    return highest_around((alpha < threshold).to(alpha.dtype), radius) < 0.5
