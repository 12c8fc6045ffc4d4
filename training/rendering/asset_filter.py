"""The paper's selection of objects (supplement, "Dataset selection"), with a reason for each that is left out.

Left out is what has no roughness or metalness map (see scene_blender.py), a point cloud, what covers fewer than ten
pixels of a view, a scan of a room, and a scene of many objects. For the last two the paper has no criterion; ours:

- A *room* is seen from outside by its back faces: of the pixels that twelve views around it cover, more than
  `INSIDE_OUT` show the inside of the surface.
- A *scene* is what falls into more than `MOST_APART` groups once its ground is taken away. Parts belong to one group
  where their bounding boxes, made larger by 1% of the whole, meet; groups with a diagonal below 5% of the whole do not
  count. Ground is a part lower than 2% of the whole that covers more than 60% of its base.
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.connectivity import components, face_components
from arm_blender.graphics.raster.rasterize import rasterize_views

LEAST_PIXELS = 10
"""The paper's: covered in every view."""

INSIDE_OUT = 0.75
"""Share of back faces. Sheets such as leaves have a half, closed objects none."""

MOST_APART = 8
"""Groups: a set of chess pieces goes, a pair of shoes or a place setting stays."""

MOST_PARTS = 2000
"""Parts that are compared, the largest first; more would take minutes."""


def unwanted_shape(
    vertices: NDArray[np.float32], faces: NDArray[np.int64], loose: int, most_triangles: int | None
) -> str | None:
    """Why the shape of an object is left out, None where it is not.

    Args:
        vertices: (N, 3) float32 world, the longest side of their box 2, centred.
        faces: (F, 3) int64.
        loose: points of the file that belong to no face.
    """
    if loose > len(np.unique(faces)):
        return f"a point cloud: {loose} points belong to no face, {len(np.unique(faces))} do"
    if most_triangles is not None and len(faces) > most_triangles:
        return f"{len(faces)} triangles, of --max-triangles {most_triangles}"
    points, triangles = torch.from_numpy(vertices), torch.from_numpy(faces)
    if (apart := groups_apart(points, triangles)) > MOST_APART:
        return f"a scene of many objects: {apart} groups of parts stand apart"
    if (share := inside_share(points, triangles)) > INSIDE_OUT:
        return f"shows its inside to {100 * share:.0f}% of the pixels around it: a scan of a room, or turned inside out"
    return None


def unwanted_views(alpha: NDArray[np.uint8]) -> str | None:
    """Why the rendered views (V, S, S) uint8 are left out, None where they are not."""
    least = int((alpha >= 128).sum(axis=(1, 2)).min())
    return f"sparse or tiny: {least} pixels in a view" if least < LEAST_PIXELS else None


def inside_share(vertices: Tensor, faces: Tensor) -> float:
    """Of the pixels around a mesh (N, 3), (F, 3) that show it, the share that shows a back face; 0 where none does."""
    cameras = [orbit_camera(30.0 * i, (-40.0, 10.0, 50.0)[i % 3], 6.0, 35.0, 48, 48) for i in range(12)]
    face_id = rasterize_views(vertices, faces, cameras).face_id  # (V, S, S)
    eyes = torch.stack([camera.center for camera in cameras])[:, None, None].expand(*face_id.shape, 3)
    shown = face_id >= 0
    if not bool(shown.any()):
        return 0.0
    a, b, c = vertices[faces[face_id[shown].long()]].unbind(dim=1)
    return float((((b - a).cross(c - a, dim=1) * (eyes[shown] - a)).sum(dim=1) < 0.0).double().mean())


def groups_apart(vertices: Tensor, faces: Tensor) -> int:
    """In how many groups of parts a mesh falls; see the module."""
    # Files split vertices where normals or texture coordinates do; unwelded, every face would be its own part.
    _, index = torch.unique((vertices * 1e4).round().long(), dim=0, return_inverse=True)
    part = face_components(index[faces])
    count, corners = int(part.max()) + 1, vertices[faces]  # (F, 3, 3)
    low = torch.full((count, 3), math.inf).scatter_reduce_(0, part[:, None].expand(-1, 3), corners.amin(1), "amin")
    high = torch.full((count, 3), -math.inf).scatter_reduce_(0, part[:, None].expand(-1, 3), corners.amax(1), "amax")
    size = high - low
    whole = high.amax(0) - low.amin(0)
    ground = (size[:, 2] < 0.02 * whole.norm()) & (size[:, 0] * size[:, 1] > 0.6 * whole[0] * whole[1])
    kept = torch.nonzero(~ground)[:, 0]
    kept = kept[size[kept].norm(dim=1).argsort(descending=True)[:MOST_PARTS]]
    if not len(kept):
        return int(bool(ground.any()))
    margin = 0.005 * whole.norm()
    low, high = low[kept] - margin, high[kept] + margin
    meet = (low[:, None] <= high[None]).all(dim=2) & (high[:, None] >= low[None]).all(dim=2)  # (P, P)
    group = components(meet.nonzero(), len(kept))
    index = group[:, None].expand(-1, 3)
    n = int(group.max()) + 1
    low = torch.full((n, 3), math.inf).scatter_reduce_(0, index, low, "amin")
    high = torch.full((n, 3), -math.inf).scatter_reduce_(0, index, high, "amax")
    return int(((high - low - 2.0 * margin).norm(dim=1) >= 0.05 * whole.norm()).sum())
