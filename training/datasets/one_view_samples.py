"""One view of an object that is stretched, turned and seen anew at every step: what a prior on shapes is learnt from.

Shapes and colours are those of `outline_samples`. Most objects stand as users' do: along the axes, centred, with a
longest side of 2, seen from their front, back or a side, from a little above.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from arm_blender.graphics.cameras import Camera, orbit_camera, unproject
from arm_blender.graphics.raster.rasterize import Fragments, rasterize_views
from arm_blender.models.network_views import NetworkViews
from arm_blender.models.small.ray_occupancy import Frustum, RayOccupancyConfig
from arm_blender.structures import stack_cameras

from .. import distributed
from ..random_numbers import uniform
from .outline_samples import Solid, deformed, pictures, random_stretch, tinted
from .point_samples import rotation_z

SIZE = 160
"""Pixels a side of the pictures and of their outlines."""

CLOUD = 32_000
"""Coloured points of a rendered rig: pictures are looked at more closely here than by cells that compare colours."""

AGAIN = (75, 200)
"""Steps after which a view is shown again; after an odd number mirrored."""

SURFACE_POINTS = 2048
"""Pixels of a view whose rays are followed through the object."""

FAVOURED = 0.4
"""Share of the draws that take an object that was scanned or measured, where there are such."""


@dataclass(frozen=True)
class OneViewBatch:
    """B objects, each seen once (V = 1), and what is true at points of them.

    Attributes:
        views: what the network takes.
        points: (B, P, 3) world. distance: (B, P) world units, positive inside.
        first, last: (B, Q, 3) world: where the rays of `SURFACE_POINTS` of the object's pixels first meet it, and where
            they leave it.
    """

    views: NetworkViews
    points: Tensor
    distance: Tensor
    first: Tensor
    last: Tensor


class Views:
    """Views of solids, each of which comes back a few times, every other time mirrored: drawing one takes as long as
    learning from it.

    Args:
        favoured: names of solids that `FAVOURED` of the draws take.
        points: of each view.
        seed: the same one gives the same views.
    """

    def __init__(self, solids: list[Solid], favoured: frozenset[str], points: int, seed: int) -> None:
        self.solids, self.points, self.seed = solids, points, seed
        self.preferred = [solid for solid in solids if solid.name in favoured]
        self._drawn: dict[int, OneViewBatch] = {}

    def batch(self, step: int, new: int) -> OneViewBatch:
        """What a step sees: `new` views, and as many of every earlier step that `AGAIN` says, as far as there are."""
        chosen = []
        for delay in (0, *AGAIN):
            if step >= delay:
                numbers = range((step - delay) * new, (step - delay + 1) * new)
                chosen += [mirrored(self[n]) if delay % 2 else self[n] for n in numbers]
        for number in [n for n in self._drawn if n < (step - AGAIN[-1]) * new]:
            del self._drawn[number]
        return stacked(chosen)

    def __getitem__(self, number: int) -> OneViewBatch:
        if number not in self._drawn:
            generator = distributed.generator(self.seed, number)
            among = self.preferred if self.preferred and uniform(generator) < FAVOURED else self.solids
            solid = among[int(torch.randint(len(among), (), generator=generator))]
            self._drawn[number] = seen(solid, _moved(solid, generator), _camera(generator), self.points, generator)
        return self._drawn[number]


def mirrored(batch: OneViewBatch) -> OneViewBatch:
    """The same in a mirror, the plane x = 0."""
    world, camera = torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0])), torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0]))
    views, flip = batch.views, torch.tensor([-1.0, 1.0, 1.0])
    K = views.K.clone()
    K[..., 0, 2] = views.silhouette.shape[-1] - K[..., 0, 2]
    views = NetworkViews(views.images.flip(-1), views.silhouette.flip(-1), world @ views.c2w @ camera, K)
    return OneViewBatch(views, batch.points * flip, batch.distance, batch.first * flip, batch.last * flip)


def stacked(drawn: list[OneViewBatch]) -> OneViewBatch:
    """Several as one."""
    images, silhouette, c2w, K = (
        torch.cat([getattr(s.views, name) for s in drawn]) for name in ("images", "silhouette", "c2w", "K")
    )
    parts = (torch.cat([getattr(s, name) for s in drawn]) for name in ("points", "distance", "first", "last"))
    return OneViewBatch(NetworkViews(images, silhouette, c2w, K), *parts)


def seen(
    solid: Solid, moved: Solid, camera: Camera, points: int, generator: torch.Generator, tint: bool = True
) -> OneViewBatch:
    """What a camera of `SIZE` pixels sees of `moved`, which is `solid` deformed, and some of its points; B = 1.

    Args:
        tint: colours are other than they are, mostly.
    """
    fragments = rasterize_views(moved.mesh.vertices, moved.mesh.faces, [camera])
    picture = pictures(solid, fragments, SIZE, generator)
    if tint and uniform(generator) < 0.7:
        picture = tinted(picture, generator)
    coverage = fragments.mask.float()
    distance = torch.from_numpy(_signed_distance(fragments.mask[0].numpy()))[None]
    images = torch.cat([picture[:, :3] + (1.0 - coverage) * RayOccupancyConfig().background, coverage[:, None]], dim=1)
    silhouette = torch.stack([coverage, distance], dim=1)
    c2w, K = stack_cameras((camera,))
    chosen = torch.randint(len(moved.points), (points,), generator=generator)
    return OneViewBatch(
        NetworkViews(images[None], silhouette[None], c2w[None], K[None]),
        moved.points[chosen][None],
        moved.distance[chosen][None],
        *_layers(moved, camera, fragments, generator),
    )


def _layers(moved: Solid, camera: Camera, fragments: Fragments, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """(1, Q, 3) where pixels' rays first meet the object, and where they leave it."""
    local = (moved.mesh.vertices - camera.center) @ camera.c2w[:3, :3]
    near = -0.5 * float(local[:, 2].max())
    # Takes lines to lines and every ray to itself, and turns depths about (z to near z / (z - near)):
    # what was farthest is nearest.
    turned = (local * (near / (-local[:, 2:] - near))) @ camera.c2w[:3, :3].T + camera.center
    back = rasterize_views(turned, moved.mesh.faces, [camera]).depth[0]
    back, front = near * back / (back - near), fragments.depth[0]
    row, column = (front.isfinite() & back.isfinite()).nonzero(as_tuple=True)
    chosen = torch.randint(len(row), (SURFACE_POINTS,), generator=generator)
    row, column = row[chosen], column[chosen]
    pixels = torch.stack([column, row], dim=1) + 0.5
    return unproject(pixels, front[row, column], camera)[None], unproject(pixels, back[row, column], camera)[None]


def _signed_distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W) as of `visual_hull.signed_silhouette_distance`, which is made for devices: this takes a tenth of it."""
    inside, outside = distance_transform_edt(mask), distance_transform_edt(~mask)
    return (np.maximum(inside - 0.5, 0.0) - np.maximum(outside - 0.5, 0.0)).astype(np.float32)


def _moved(solid: Solid, generator: torch.Generator) -> Solid:
    """Stretched, turned by quarters about Z and mirrored; seldom in any position, or smaller than the box."""
    linear = rotation_z(0.5 * math.pi * int(torch.randint(4, (), generator=generator)))
    if uniform(generator) < 0.1:
        linear = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    if uniform(generator) < 0.5:
        linear = linear @ torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    longest = 2.0 if uniform(generator) < 0.8 else uniform(generator, 1.4, 2.0)
    return deformed(solid, linear * random_stretch(generator), longest)


def _camera(generator: torch.Generator) -> Camera:
    """Mostly in front, 10° above, six units away; else anywhere users' cameras are."""
    azimuth, elevation, distance = 4.0 * float(torch.randn((), generator=generator)), 10.0, 6.0
    if uniform(generator) < 0.25:
        azimuth = uniform(generator, 0.0, 360.0)
    if uniform(generator) < 0.25:
        elevation = uniform(generator, -20.0, 60.0)
    else:
        elevation += 3.0 * float(torch.randn((), generator=generator))
    if uniform(generator) < 0.25:
        distance = uniform(generator, 2.5, 9.0)
    camera = orbit_camera(azimuth, elevation, distance, 30.0, SIZE, SIZE)
    # A little more or less than the network looks at, so that it meets pictures of any sharpness.
    half = float(Frustum.of(camera.center[None]).half) * uniform(generator, 0.95, 1.3)
    fovy = 2.0 * math.degrees(math.atan(half / distance))
    return orbit_camera(azimuth, elevation, distance, fovy, SIZE, SIZE)
