"""Samples that need no rendering: outlines of known meshes, stretched and turned at random, and what is solid in them.

What outlines alone tell of a shape (that a facet of the visual hull is seldom a facet of the object) has no need of
pictures, and learning it wants far more shapes than there are objects.
"""

import logging
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.graphics.rasterize import rasterize_views
from arm_blender.models.visual_hull import Outlines, signed_silhouette_distance
from arm_blender.structures import TriangleMesh, stack_cameras
from arm_blender.views.rigs import AZIMUTHS_DEG, ELEVATIONS_DEG

from . import shards
from .point_samples import is_held_out

logger = logging.getLogger(__name__)

SIZE = 128
"""Pixels a side of the outlines."""

FRAME = 3.2
"""World units that a view frames at the origin."""

MOST_FACES = 50_000
"""An object of more is left out: its outlines take longer to draw than a step takes."""

STRETCH = 0.4
"""Largest logarithm of the factor along an axis."""


@dataclass(frozen=True)
class Solid:
    """An object as points that are inside or outside: mesh, points (P, 3), signed distance (P,) as in occupancy.npz."""

    mesh: TriangleMesh
    points: Tensor
    distance: Tensor


@dataclass(frozen=True)
class OutlineBatch:
    """B objects: outlines of six views, points (B, P, 3) and their signed distances (B, P), world units."""

    outlines: Outlines
    points: Tensor
    distance: Tensor


def load_solids(folder: Path) -> list[Solid]:
    """The training objects of a folder of shards."""
    solids = []
    for path in shards.meshes(folder):
        if is_held_out(path) or not path.with_name("occupancy.npz").exists():
            continue
        mesh = shards.read_mesh(path)
        with np.load(path.with_name("occupancy.npz")) as file:
            points, distance = torch.from_numpy(file["points"]), torch.from_numpy(file["distance"])
        if len(mesh.faces) <= MOST_FACES and int((distance > 0).sum()) > 100:
            solids.append(Solid(mesh, points, distance))
    logger.info("%d solids", len(solids))
    return solids


def batch(solids: list[Solid], count: int, points: int, generator: torch.Generator) -> OutlineBatch:
    """`count` of the objects, each stretched, turned and seen anew, at `points` points."""
    drawn = [
        _seen(_moved(solids[int(torch.randint(len(solids), (), generator=generator))], generator), points, generator)
        for _ in range(count)
    ]
    outlines = [sample.outlines for sample in drawn]
    return OutlineBatch(
        Outlines(*(torch.cat([getattr(o, name) for o in outlines]) for name in ("silhouette", "c2w", "K"))),
        torch.cat([sample.points for sample in drawn]),
        torch.cat([sample.distance for sample in drawn]),
    )


def _uniform(low: float, high: float, generator: torch.Generator) -> float:
    return low + (high - low) * float(torch.rand((), generator=generator))


def _moved(solid: Solid, generator: torch.Generator) -> Solid:
    """Stretched along its axes, turned, and scaled into the box.

    Distances scale by the geometric mean of the stretch: their signs are exact, their sizes are not.
    """
    stretch = torch.ones(3)
    if _uniform(0.0, 1.0, generator) < 0.8:
        stretch = ((torch.rand(3, generator=generator) * 2.0 - 1.0) * STRETCH).exp()
    if _uniform(0.0, 1.0, generator) < 0.15:
        rotation = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    else:
        # Objects of artists and scanners mostly stand along the axes.
        quarters = _uniform(0.0, 4.0, generator)
        angle = 0.5 * math.pi * (math.floor(quarters) if _uniform(0.0, 1.0, generator) < 0.5 else quarters)
        rotation = torch.tensor(
            [
                [math.cos(angle), -math.sin(angle), 0.0],
                [math.sin(angle), math.cos(angle), 0.0],
                [0.0, 0.0, 1.0],
            ]
        )
    if _uniform(0.0, 1.0, generator) < 0.5:
        rotation = rotation @ torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    linear = rotation * stretch
    vertices = solid.mesh.vertices @ linear.T
    low, high = vertices.amin(0), vertices.amax(0)
    scale = _uniform(1.6, 2.0, generator) / float((high - low).amax())
    center = 0.5 * (low + high)
    points = (solid.points.float() @ linear.T - center) * scale
    distance = solid.distance.float() * (scale * float(stretch.prod()) ** (1.0 / 3.0))
    kept = points.abs().amax(dim=1) <= 1.0
    return Solid(TriangleMesh((vertices - center) * scale, solid.mesh.faces), points[kept], distance[kept])


def _rig(generator: torch.Generator) -> list[Camera]:
    """Mostly the Zero123++ rig; otherwise one like it."""
    turn, distance, jitter = 0.0, 6.0, torch.zeros(2, 6)
    if _uniform(0.0, 1.0, generator) < 0.25:
        turn, distance = _uniform(0.0, 60.0, generator), _uniform(3.0, 8.0, generator)
        jitter = 10.0 * torch.randn(2, 6, generator=generator)
    fovy = 2.0 * math.degrees(math.atan(0.5 * FRAME / distance))
    return [
        orbit_camera(azimuth + turn + float(a), elevation + float(b), distance, fovy, SIZE, SIZE)
        for azimuth, elevation, a, b in zip(AZIMUTHS_DEG, ELEVATIONS_DEG, *jitter, strict=True)
    ]


def _seen(solid: Solid, points: int, generator: torch.Generator) -> OutlineBatch:
    """Its outlines in a rig, and some of its points; B = 1."""
    cameras = _rig(generator)
    coverage = rasterize_views(solid.mesh.vertices, solid.mesh.faces, cameras).mask.float()
    silhouette = torch.stack([coverage, signed_silhouette_distance(coverage)], dim=1)
    c2w, K = stack_cameras(cameras)
    chosen = torch.randint(len(solid.points), (points,), generator=generator)
    return OutlineBatch(
        Outlines(silhouette[None], c2w[None], K[None]), solid.points[chosen][None], solid.distance[chosen][None]
    )
