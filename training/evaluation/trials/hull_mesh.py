"""The visual hull of the masks of posed views: the baseline that a learned shape has to beat.

It is the largest shape that fits all silhouettes, and knows of no concavity. It is extracted as the network's density
is, on the same grid, so that only the field differs.
"""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from arm_blender.graphics.cameras import project
from arm_blender.graphics.surface.isosurface import extract
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig
from arm_blender.structures import TriangleMesh, ViewSet


def visual_hull(views: ViewSet, resolution: int) -> TriangleMesh:
    """The surface of the hull inside [-1, 1]^3.

    Args:
        views: posed views; only their alpha is looked at.
        resolution: grid samples a side.
    Raises:
        EmptyMeshError: no point lies in all masks.
    """
    # Dense: a coarse pass could miss what lies between its samples, and the field is cheap.
    return extract(silhouette_field(views), IsosurfaceConfig(resolution=resolution, iso=0.5, dense=True))


def silhouette_field(views: ViewSet) -> Callable[[Tensor], Tensor]:
    """The least alpha that any view shows at a point: (P, 3) world -> (P,) in [0, 1]; at least 0.5 inside the hull.

    A point that a view does not show, beside its image or behind its camera, is outside.
    """
    alphas, cameras = views.images[:, 3:], views.cameras

    def field(points: Tensor) -> Tensor:
        least = torch.ones(points.shape[0], dtype=points.dtype, device=points.device)
        for alpha, camera in zip(alphas, cameras, strict=True):
            pixels, depth = project(points, camera)
            size = torch.tensor([camera.width, camera.height], dtype=points.dtype, device=points.device)
            # With align_corners=False the outer edges of the image lie at -1 and 1, pixel centres at +0.5.
            grid = (2.0 * pixels / size - 1.0)[None, None]
            seen = grid_sample(alpha[None], grid, mode="bilinear", padding_mode="zeros", align_corners=False)
            least = torch.minimum(least, torch.where(depth > 0.0, seen[0, 0, 0], 0.0))
        return least

    return field
