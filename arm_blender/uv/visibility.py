"""Which surface points a camera sees: a z-buffer of the mesh itself, with room for a mesh that is a pixel off."""

import torch
from torch import Tensor
from torch.nn import functional

from ..graphics.cameras import Camera, project
from ..graphics.rasterize import rasterize
from ..structures import UvMesh


def depth_buffer(mesh: UvMesh, camera: Camera, resolution: int) -> tuple[Tensor, Camera]:
    """The z-buffer of a mesh, `resolution` pixels on its longer side, and the camera of that size."""
    scale = resolution / max(camera.width, camera.height)
    sized = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
    return rasterize(mesh.vertices, mesh.faces, sized).depth, sized


def unoccluded(
    points: Tensor, cosine: Tensor, buffer: Tensor, camera: Camera, radius: int, depth_bias: float, slope_bias: float
) -> tuple[Tensor, Tensor]:
    """Points that nothing hides, and those of them that also keep their distance from an edge of their own surface.

    Args:
        points: (P, 3) world.
        cosine: (P,) n.v, positive.
        buffer: (H, W) z-buffer along the view axis, world units; infinity is background.
        camera: of the buffer.
        radius: pixels of the buffer by which an outline may be off. Whatever is hidden anywhere so near is hidden.
        depth_bias: world units.
        slope_bias: pixels of the buffer, added to `radius`, over which a slanted surface may fall or rise.
    Returns:
        (P,) bool unoccluded, (P,) bool unoccluded and away from where the surface breaks off before a deeper one.
    """
    height, width = buffer.shape
    where, depth = project(points, camera)
    inside = (depth > 0) & (where >= 0).all(dim=1) & (where[:, 0] < width) & (where[:, 1] < height)
    column, row = where[:, 0].long().clamp(0, width - 1), where[:, 1].long().clamp(0, height - 1)
    tangent = (1.0 - cosine**2).clamp(min=0.0).sqrt() / cosine.clamp(min=1e-3)
    bias = depth_bias + (radius + slope_bias) * tangent * depth / camera.K[0, 0]
    nearest = -_widest(-buffer, radius)[row, column]
    # Against the background it is the picture's alpha that tells the outline.
    deepest = _widest(torch.where(torch.isinf(buffer), -torch.inf, buffer), radius)[row, column]
    free = inside & (depth <= nearest + bias)
    return free, free & (deepest <= depth + bias)


def opaque_pixels(alpha: Tensor, threshold: float, radius: int) -> Tensor:
    """(H, W) bool: pixels of at least `threshold` alpha without a lesser one within `radius` pixels."""
    return _widest((alpha < threshold).to(alpha.dtype), radius) < 0.5


def _widest(image: Tensor, radius: int) -> Tensor:
    """(H, W) maximum over the square of `radius` pixels around; beyond the border there is nothing."""
    # Two passes of one dimension: a square maximum costs the radius, not its square.
    rows = functional.max_pool2d(image[None, None], (2 * radius + 1, 1), stride=1, padding=(radius, 0))
    return functional.max_pool2d(rows, (1, 2 * radius + 1), stride=1, padding=(0, radius))[0, 0]
