"""Where a hand holds the camera, and through which lens it looks: what is drawn of a simulated capture."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from arm_blender.graphics.cameras import look_at
from arm_blender.photographs.capture import Lens

Spoilt = Literal["repeating", "few", "turned", "blurred", "two"]
SPOILT: tuple[Spoilt, ...] = ("repeating", "few", "turned", "blurred", "two")
"""What can be wrong with a capture: its ground repeats; it has few pictures, all from one side; the object was turned
between the pictures, while its surroundings stood still; every picture is blurred; a second thing stands beside it."""

PICTURES = 12, 40
"""Fewest and most of a capture that is not spoilt."""

FEW = 5
"""Pictures of a capture that is spoilt by having few."""

LONG_SIDE_FOV_DEG = 65.0, 75.0
"""Of the main camera of phones, across the longer side of the picture, degrees."""

_RINGS = ((2.0 / 3.0, 14.0), (1.0 / 3.0, 42.0))
"""Share of the pictures and elevation in degrees of each walk around the object."""


@dataclass(frozen=True)
class CaptureConfig:
    """How an object is photographed."""

    pictures: int = 24
    """12 to 40, in two rings."""
    long_side: int = 800
    """Pixels; the other side is three quarters of it."""
    k1: float = 0.0
    """Radial distortion of the lens, as of COLMAP's SIMPLE_RADIAL; phones correct it, and leave .05 at most."""
    spoilt: Spoilt | None = None
    """What is wrong on purpose."""
    clutter: bool = False
    """Whether things stand further away on the ground."""
    seed: int = 0
    """Of everything that is drawn, together with the object's key and the setting's number."""


@dataclass(frozen=True)
class Pose:
    """Of one picture.

    Attributes:
        c2w: (4, 4) float32, of the camera in the surroundings, OpenGL axes.
        turn: radians that the object is turned by about the vertical, counter-clockwise seen from above.
    """

    c2w: Tensor
    turn: float = 0.0

    def around_object(self) -> Tensor:
        """(4, 4) float64 c2w in the frame of the object, as it stood before it was turned."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        back = torch.eye(4, dtype=torch.float64)
        back[:2, :2] = torch.tensor([[c, s], [-s, c]], dtype=torch.float64)
        return back @ self.c2w.double()


def phone_lens(config: CaptureConfig, rng: np.random.Generator) -> Lens:
    """Of all pictures of a capture."""
    width, height = config.long_side, round(0.75 * config.long_side)
    focal = width / (2.0 * math.tan(math.radians(rng.uniform(*LONG_SIDE_FOV_DEG)) / 2.0))
    if config.k1:
        return Lens("SIMPLE_RADIAL", (focal, width / 2.0, height / 2.0, config.k1), width, height)
    return Lens("SIMPLE_PINHOLE", (focal, width / 2.0, height / 2.0), width, height)


def hand_held(config: CaptureConfig, half_size: float, rng: np.random.Generator) -> list[Pose]:
    """Two uneven walks around the origin, one after the other.

    Args:
        half_size: half of the object's diagonal, world units; the object lies around the origin.
    """
    if config.spoilt == "few":
        return [_pose(math.radians(60.0 * k / FEW), 16.0, half_size, rng) for k in range(FEW)]
    if config.spoilt == "turned":
        steps = 2.0 * math.pi / config.pictures
        return [
            Pose(_pose(0.0, 22.0, half_size, rng).c2w, steps * (k + rng.uniform(-0.2, 0.2)))
            for k in range(config.pictures)
        ]
    poses: list[Pose] = []
    for share, elevation_deg in _RINGS:
        count = round(share * config.pictures)
        start = rng.uniform(0.0, 2.0 * math.pi)
        for k in range(count):
            azimuth = start + 2.0 * math.pi * (k + rng.uniform(-0.2, 0.2)) / count
            poses.append(_pose(azimuth, elevation_deg, half_size, rng))
    return poses


def _pose(azimuth: float, elevation_deg: float, half_size: float, rng: np.random.Generator) -> Pose:
    """Near to an azimuth (radians) and an elevation, from as far as the object takes about half of the picture."""
    elevation = math.radians(elevation_deg + rng.uniform(-5.0, 5.0))
    distance = max(half_size, 0.8) * rng.uniform(2.3, 3.0)
    eye = distance * torch.tensor(
        [
            math.cos(elevation) * math.sin(azimuth),
            -math.cos(elevation) * math.cos(azimuth),
            math.sin(elevation),
        ]
    )
    target = torch.from_numpy(rng.uniform(-0.1, 0.1, 3).astype(np.float32))
    roll = rng.uniform(-0.06, 0.06)
    turned = torch.eye(4)
    turned[:2, :2] = torch.tensor([[math.cos(roll), -math.sin(roll)], [math.sin(roll), math.cos(roll)]])
    return Pose(look_at(eye, target) @ turned)
