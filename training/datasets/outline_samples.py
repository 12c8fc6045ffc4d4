"""Samples that need no rendering: outlines and colours of known meshes, stretched and turned at random.

What outlines tell of a shape (that a facet of the visual hull is seldom a facet of the object), and where views agree
on a colour, has no need of new pictures, and learning it wants far more shapes than there are objects. A point of the
surface has the colour of the nearest point that some picture of the object shows.
"""

import logging
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from arm_blender.graphics.cameras import Camera, orbit_camera, unproject
from arm_blender.graphics.raster.rasterize import Fragments, rasterize_views
from arm_blender.graphics.visual_hull import Outlines, signed_silhouette_distance
from arm_blender.models.small.feature_volume import object_colors
from arm_blender.structures import TriangleMesh, stack_cameras
from arm_blender.views.rigs import AZIMUTHS_DEG, ELEVATIONS_DEG

from ..random_numbers import uniform
from ..rendering import shards
from .point_samples import drop_views, is_held_out, rotation_z

logger = logging.getLogger(__name__)

SIZES = (160, 160, 240, 320)
"""Pixels a side of the outlines, one drawn a batch: small ones are fast, users' are large. Multiples of `COLORED`."""

COLORED = 80
"""Pixels a side at which colours are looked up; the network's cells compare squares of two by two."""

CLOUD = 16_000
"""Coloured points kept of one rendered rig: 0.02 world units apart on the surface."""

FRAME = 3.2
"""World units that a view frames at the origin."""

MOST_FACES = 50_000
"""An object of more is left out: its outlines take longer to draw than a step takes."""

DROPPED = 0.25
"""Share of the steps that see fewer than six views: from scratch a network forgets what it does not see often."""

STRETCH = 0.4
"""Largest logarithm of the factor along an axis."""


Cloud = tuple[NDArray[np.float32], NDArray[np.uint8]]
"""Points and colours, (C, 3) each."""


@dataclass(frozen=True)
class Solid:
    """An object, its points inside and outside, and its colours.

    Attributes:
        name: its id.
        mesh: its surface.
        points, distance: (P, 3) and (P,) as in occupancy.npz.
        clouds: of each rendered rig, surface points (C, 3) float32 and sRGB colours (C, 3) uint8, as that rig is lit.
    """

    name: str
    mesh: TriangleMesh
    points: Tensor
    distance: Tensor
    clouds: tuple[Cloud, ...]


@dataclass(frozen=True)
class OutlineBatch:
    """B objects: outlines of six views, points (B, P, 3) and their signed distances (B, P), world units.

    `colors` (B, V, 4, h, w) are those of `HullViews`.
    """

    outlines: Outlines
    colors: Tensor
    points: Tensor
    distance: Tensor


def load_solids(folder: Path, held_out: bool = False, cloud: int = CLOUD) -> list[Solid]:
    """The training objects of a folder of shards, or those that only validate.

    Args:
        cloud: coloured points kept of a rendered rig.
    Raises:
        ArmError: there are none.
    """
    solids = []
    for path in shards.meshes(folder):
        if is_held_out(path) != held_out or not path.with_name("occupancy.npz").exists():
            continue
        mesh = shards.read_mesh(path)
        with np.load(path.with_name("occupancy.npz")) as file:
            points, distance = torch.from_numpy(file["points"]), torch.from_numpy(file["distance"])
        rigs = shards.rigs_of(path.parent)
        if len(mesh.faces) <= MOST_FACES and int((distance > 0).sum()) > 100 and rigs:
            clouds = tuple(_cloud(rig, cloud) for rig in rigs)
            solids.append(Solid(path.parent.name, mesh, points, distance, clouds))
    logger.info("%d solids", len(solids))
    if not solids:
        raise shards.nothing_prepared(folder)
    return solids


def _cloud(path: Path, count: int) -> Cloud:
    """What all pictures of a rig show, as points (C, 3) and colours (C, 3)."""
    arrays = shards.arrays(path, "rgba", "depth", "c2w", "K")
    points, colors = [], []
    for rgba, depth, camera in zip(arrays["rgba"], arrays["depth"], shards.cameras(arrays), strict=True):
        # Pixels at the outline mix the object with what is behind it.
        row, column = np.nonzero((rgba[..., 3] == 255) & np.isfinite(depth))
        pixels = torch.from_numpy(np.stack([column, row], axis=1)).float() + 0.5
        points.append(unproject(pixels, torch.from_numpy(depth[row, column].astype(np.float32)), camera).numpy())
        colors.append(rgba[row, column, :3])
    points, colors = np.concatenate(points), np.concatenate(colors)
    kept = np.random.default_rng(0).permutation(len(points))[:count]
    return points[kept], colors[kept]


def batch(solids: list[Solid], count: int, points: int, generator: torch.Generator) -> OutlineBatch:
    """`count` of the objects, each stretched, turned and seen anew by the same views, at `points` points."""
    drawn, size = [], SIZES[int(torch.randint(len(SIZES), (), generator=generator))]
    for _ in range(count):
        solid = solids[int(torch.randint(len(solids), (), generator=generator))]
        drawn.append(_seen(solid, _moved(solid, generator), size, points, generator))
    keep = drop_views(generator, DROPPED)
    silhouette, c2w, K = (
        torch.cat([getattr(s.outlines, name)[:, keep] for s in drawn]) for name in ("silhouette", "c2w", "K")
    )
    return OutlineBatch(
        Outlines(silhouette, c2w, K),
        torch.cat([sample.colors[:, keep] for sample in drawn]),
        torch.cat([sample.points for sample in drawn]),
        torch.cat([sample.distance for sample in drawn]),
    )


def _moved(solid: Solid, generator: torch.Generator) -> Solid:
    """Stretched along its axes, turned, and scaled into the box."""
    stretch = random_stretch(generator)
    if uniform(generator) < 0.15:
        rotation = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    else:
        # Objects of artists and scanners mostly stand along the axes.
        quarters = uniform(generator, 0.0, 4.0)
        angle = 0.5 * math.pi * (math.floor(quarters) if uniform(generator) < 0.5 else quarters)
        rotation = rotation_z(angle)
    if uniform(generator) < 0.5:
        rotation = rotation @ torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    return deformed(solid, rotation * stretch, uniform(generator, 1.6, 2.0))


def random_stretch(generator: torch.Generator) -> Tensor:
    """(3,) factors along the axes; in a fifth of the draws they are 1."""
    if uniform(generator) < 0.8:
        return ((torch.rand(3, generator=generator) * 2.0 - 1.0) * STRETCH).exp()
    return torch.ones(3)


def deformed(solid: Solid, linear: Tensor, longest: float) -> Solid:
    """A solid after a linear map (3, 3), centred, and scaled so that its longest side is `longest`.

    Distances scale by the mean of the map's stretch: their signs are exact, their sizes are not.
    """
    vertices = solid.mesh.vertices @ linear.T
    low, high = vertices.amin(0), vertices.amax(0)
    scale = longest / float((high - low).amax())
    center = 0.5 * (low + high)
    points = (solid.points.float() @ linear.T - center) * scale
    distance = solid.distance.float() * (scale * float(torch.linalg.det(linear).abs()) ** (1.0 / 3.0))
    kept = points.abs().amax(dim=1) <= 1.0
    mesh = TriangleMesh((vertices - center) * scale, solid.mesh.faces)
    return replace(solid, mesh=mesh, points=points[kept], distance=distance[kept])


def _rig(size: int, generator: torch.Generator) -> list[Camera]:
    """Mostly the Zero123++ rig; otherwise one like it."""
    turn, distance, jitter = 0.0, 6.0, torch.zeros(2, 6)
    if uniform(generator) < 0.25:
        turn, distance = uniform(generator, 0.0, 60.0), uniform(generator, 3.0, 8.0)
        jitter = 10.0 * torch.randn(2, 6, generator=generator)
    fovy = 2.0 * math.degrees(math.atan(0.5 * FRAME / distance))
    return [
        orbit_camera(azimuth + turn + float(a), elevation + float(b), distance, fovy, size, size)
        for azimuth, elevation, a, b in zip(AZIMUTHS_DEG, ELEVATIONS_DEG, *jitter, strict=True)
    ]


def _seen(solid: Solid, moved: Solid, size: int, points: int, generator: torch.Generator) -> OutlineBatch:
    """What a rig sees of `moved`, which is `solid` stretched and turned, and some of its points; B = 1."""
    cameras = _rig(size, generator)
    fragments = rasterize_views(moved.mesh.vertices, moved.mesh.faces, cameras)
    coverage = fragments.mask.float()
    silhouette = torch.stack([coverage, signed_silhouette_distance(coverage)], dim=1)
    c2w, K = stack_cameras(cameras)
    chosen = torch.randint(len(moved.points), (points,), generator=generator)
    shown = tinted(pictures(solid, fragments, COLORED, generator), generator)
    return OutlineBatch(
        Outlines(silhouette[None], c2w[None], K[None]),
        object_colors(shown, 0.0, COLORED)[None],
        moved.points[chosen][None],
        moved.distance[chosen][None],
    )


def pictures(solid: Solid, fragments: Fragments, side: int, generator: torch.Generator) -> Tensor:
    """(V, 4, side, side) sRGB on black, and coverage: `solid` as fragments show it, under one of its rigs' lights.

    Args:
        solid: as it was before it was deformed into what is shown.
        side: pixels a side, of which those of the fragments are a multiple.
    """
    step = fragments.face_id.shape[-1] // side
    middle = slice(step // 2, None, step)
    face_id, barycentric = fragments.face_id[:, middle, middle], fragments.barycentric[:, :, middle, middle]
    view, row, column = (face_id >= 0).nonzero(as_tuple=True)
    corner = solid.mesh.vertices[solid.mesh.faces[face_id[view, row, column]]]  # (P, 3, 3)
    place = (barycentric[view, :, row, column][..., None] * corner).sum(dim=1)
    positions, shown = solid.clouds[int(torch.randint(len(solid.clouds), (), generator=generator))]
    image = torch.zeros(len(face_id), 4, side, side)
    if len(positions) and len(place):
        nearest = cKDTree(positions, balanced_tree=False, compact_nodes=False).query(place.numpy())[1]
        color = torch.from_numpy(shown[nearest]).float() / 255.0
        image[view, :, row, column] = torch.cat([color, torch.ones(len(color), 1)], dim=1)
    return image


def tinted(images: Tensor, generator: torch.Generator) -> Tensor:
    """Pictures (V, 4, h, w) of another exposure and tint, and the channels in another order; views differ a little."""
    gain = torch.empty(3).uniform_(0.6, 1.3, generator=generator)
    gain = gain * torch.empty(len(images), 1).uniform_(0.95, 1.05, generator=generator)
    color = (images[:, torch.randperm(3, generator=generator)] * gain[..., None, None]).clamp(max=1.0)
    return torch.cat([color, images[:, 3:]], dim=1)
