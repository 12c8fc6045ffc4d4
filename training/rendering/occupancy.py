"""`python -m training prepare`: signed distances to the solid that the *visible* outer surface bounds.

Most scans and game assets are not watertight and many have hidden inner walls: no view can tell what is inside, and a
loss on it punishes what cannot be known. So the truth is carved: a point is outside if any of 64 cameras around the
object sees past it. Open bowls and cups stay hollow, closed ones become solid.
"""

import argparse
import logging
import math
from pathlib import Path

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from arm_blender.commands.progress_line import Counted
from arm_blender.graphics.cameras import Camera, intrinsics_from_fovy, look_at, project
from arm_blender.graphics.meshes import sample_surface
from arm_blender.graphics.raster.rasterize import rasterize
from arm_blender.structures import TriangleMesh

from .shards import meshes, read_mesh, save_arrays

logger = logging.getLogger(__name__)

CARVING_VIEWS, CARVING_SIZE, CARVING_DISTANCE = 64, 256, 6.0
SURFACE_POINTS = 80_000
FARTHEST = 0.25  # World units; beyond it only the sign matters, and a bounded search is many times faster.
NEAR_POINTS, BAND_POINTS, BOX_POINTS = 20_000, 10_000, 10_000


def views_around(mesh: TriangleMesh) -> tuple[list[tuple[Camera, Tensor]], float]:
    """Cameras on a Fibonacci sphere that frame a mesh, each with the depth that it sees, and a pixel in world units."""
    radius = float(mesh.vertices.norm(dim=1).max())
    fovy = 2.0 * math.asin(min(0.95, 1.02 * radius / CARVING_DISTANCE))
    K = intrinsics_from_fovy(fovy, CARVING_SIZE, CARVING_SIZE)
    index = torch.arange(CARVING_VIEWS) + 0.5
    z = 1.0 - 2.0 * index / CARVING_VIEWS
    angle = math.pi * (1.0 + 5.0**0.5) * index
    ring = (1.0 - z * z).sqrt()
    eyes = CARVING_DISTANCE * torch.stack([ring * angle.cos(), ring * angle.sin(), z], dim=1)
    cameras = [Camera(look_at(eye), K, CARVING_SIZE, CARVING_SIZE) for eye in eyes]
    pixel = 2.0 * CARVING_DISTANCE * math.tan(cameras[0].fovy / 2.0) / CARVING_SIZE
    return [(camera, rasterize(mesh.vertices, mesh.faces, camera).depth) for camera in cameras], pixel


def in_front(points: Tensor, views: list[tuple[Camera, Tensor]], margin: float) -> Tensor:
    """(P,) bool: points (P, 3) more than `margin`, world units, in front of what any of the views sees."""
    found = torch.zeros(len(points), dtype=torch.bool)
    for camera, depth in views:
        pixels, own = project(points, camera)
        column, row = pixels.long().clamp(0, CARVING_SIZE - 1).unbind(dim=1)
        found |= depth[row, column] - own > margin
    return found


def signed_distances(mesh: TriangleMesh, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Points around the visible surface and their signed distances to it.

    Returns:
        points (P, 3) in the box, world; distance (P,) world units within +-FARTHEST, positive inside.
    """

    def normal(count: int, scale: float) -> Tensor:
        return torch.randn(count, 3, generator=generator) * scale

    surface = sample_surface(mesh.vertices, mesh.faces, SURFACE_POINTS, generator)[0]
    views, pixel = views_around(mesh)
    surface = surface[in_front(surface, views, -pixel)]
    near = surface[torch.randint(len(surface), (NEAR_POINTS,), generator=generator)]
    low, high = mesh.vertices.amin(0), mesh.vertices.amax(0)
    points = torch.cat(
        [
            near[: NEAR_POINTS // 2] + normal(NEAR_POINTS // 2, 0.02),
            near[NEAR_POINTS // 2 :] + normal(NEAR_POINTS - NEAR_POINTS // 2, 0.08),
            low + (high - low) * torch.rand(BAND_POINTS, 3, generator=generator),
            torch.rand(BOX_POINTS, 3, generator=generator) * 2.0 - 1.0,
        ]
    ).clamp(-1.0, 1.0)
    # Half a pixel of slack: depth is known at pixel centres only.
    outside = in_front(points, views, 0.5 * pixel)
    distance = torch.from_numpy(cKDTree(surface.numpy()).query(points.numpy(), distance_upper_bound=FARTHEST)[0])
    distance = distance.float().clamp(max=FARTHEST)
    return points, torch.where(outside, -distance, distance)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words of `python -m training prepare`."""
    parser.add_argument(
        "--shards", type=Path, required=True, help="folder of samples; those without distances get them"
    )


def run(args: argparse.Namespace) -> int:
    """Write `occupancy.npz` beside every `mesh.npz` that has none yet."""
    waiting = [path for path in meshes(args.shards) if not path.with_name("occupancy.npz").exists()]
    count = Counted(len(waiting), logger.info)
    for path in waiting:
        points, distance = signed_distances(read_mesh(path), torch.Generator().manual_seed(0))
        save_arrays(
            path.with_name("occupancy.npz"), {"points": points.half().numpy(), "distance": distance.half().numpy()}
        )
        inside = float((distance[-BOX_POINTS:] > 0).float().mean())
        count(f"{path.parent.name}: {inside:.0%} of the box points are inside")
    return 0
