"""From where an object is rendered: the paper's two sets of views, or rigs as varied as users' pictures."""

import math
from functools import partial

import numpy as np
import torch

from arm_blender.graphics.cameras import Camera, intrinsics_from_fovy, look_at, orbit_camera
from arm_blender.views.rigs import zero123plus_rig

from ..random_numbers import uniform

INPUT_VIEWS, EXTRA_VIEWS = 6, 4

DISTANCES, HEIGHTS, FOVY_DEG = (2.0, 3.5), (-0.75, 1.6), 50.0
"""Of InstantMesh's random views, whose data ARM's is said to follow: world units where the box is [-1, 1]^3."""


def paper_rig(rng: np.random.Generator, size: int, views: int = 32, distance: float = 6.0) -> tuple[Camera, ...]:
    """ARM's two sets: first the six input views of the Zero123++ rig, then `views` random ones.

    A random view is drawn in distance and height of the camera, and looks at the origin. The closest ones cut off the
    corners of a full box, as InstantMesh's do.

    Args:
        size: pixels a side.
        distance: of the input views; at 6 a full box is inside the picture.
    """
    K = intrinsics_from_fovy(math.radians(FOVY_DEG), size, size)
    cameras = list(zero123plus_rig(distance=distance, size=size))
    for _ in range(views):
        far, height, azimuth = rng.uniform(*DISTANCES), rng.uniform(*HEIGHTS), rng.uniform(0.0, 2.0 * math.pi)
        ring = math.sqrt(far * far - height * height)
        eye = torch.tensor([ring * math.sin(azimuth), -ring * math.cos(azimuth), height], dtype=torch.float32)
        cameras.append(Camera(look_at(eye), K, size, size))
    return tuple(cameras)


def varied_rig(rng: np.random.Generator, size: int) -> tuple[Camera, ...]:
    """Six input views, of a turned Zero123++ rig or of a free rig, and four more from anywhere.

    Fields of view go from 18° to 55° and distances from 2.6 to 9, as users bring them. A ball of radius 1.14 to 1.79
    around the origin fills the frame, so that a mask cuts off no more than the corners of a full box.
    """
    framed = partial(_framed, size)
    # Objects are photographed and modelled along their axes: half of the rigs stand as users' do.
    turn = 90.0 * rng.integers(4) if rng.random() < 0.5 else rng.uniform(0.0, 360.0)
    if rng.random() < 0.6:
        fill = rng.uniform(0.7, 1.1)
        views = [framed(turn + 30.0 + 60.0 * i, (20.0, -10.0)[i % 2], 30.0, fill) for i in range(INPUT_VIEWS)]
    else:
        fovy_deg = rng.uniform(18.0, 55.0)
        views = [
            framed(
                turn + 60.0 * i + rng.uniform(-25.0, 25.0),
                rng.uniform(-25.0, 55.0),
                fovy_deg,
                rng.uniform(0.7, 1.05),
            )
            for i in range(INPUT_VIEWS)
        ]
    views += [
        framed(rng.uniform(0.0, 360.0), math.degrees(math.asin(rng.uniform(-0.6, 0.95))), rng.uniform(25.0, 50.0), 0.95)
        for _ in range(EXTRA_VIEWS)
    ]
    return tuple(views)


def random_views(size: int, generator: torch.Generator) -> tuple[Camera, ...]:
    """As `varied_rig`, by a generator of torch, and turned by any angle: what is rasterised anew in every step."""
    draw = partial(uniform, generator)
    framed = partial(_framed, size)
    turn, fill, fovy_deg, loose = draw(0.0, 360.0), draw(0.7, 1.1), draw(18.0, 55.0), draw(0.0, 1.0) > 0.6
    views = []
    for k in range(INPUT_VIEWS):
        azimuth_deg = turn + 30.0 + 60.0 * k
        if loose:
            views.append(framed(azimuth_deg + draw(-25.0, 25.0), draw(-25.0, 55.0), fovy_deg, draw(0.7, 1.05)))
        else:
            views.append(framed(azimuth_deg, (20.0, -10.0)[k % 2], 30.0, fill))  # Zero123++ v1.2.
    for _ in range(EXTRA_VIEWS):
        elevation_deg = math.degrees(math.asin(draw(-0.6, 0.95)))
        views.append(framed(draw(0.0, 360.0), elevation_deg, draw(25.0, 50.0), 0.95))
    return tuple(views)


def _framed(size: int, azimuth_deg: float, elevation_deg: float, fovy_deg: float, fill: float) -> Camera:
    """From so far that a ball of radius 1.25 / fill around the origin fits the frame, 1.8 at least and 9 at most."""
    distance = 1.25 / (fill * math.sin(math.radians(fovy_deg) / 2.0))
    return orbit_camera(azimuth_deg, elevation_deg, min(max(distance, 1.8), 9.0), fovy_deg, size, size)
