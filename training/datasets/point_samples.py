"""Samples that tell at points how well a shape is found, compact in memory; and what all stages draw alike."""

import argparse
import math
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from arm_blender.config import PRESETS
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.models.network_views import NetworkViews, network_views
from arm_blender.structures import ViewSet

from .. import options
from ..rendering import shards

INPUTS = 6
"""The first views of a rig are what a network sees."""

HELD_OUT_EVERY = 32
"""One object in so many validates."""


@dataclass(frozen=True)
class PointSample:
    """One rig of one object, and what is true at points of it.

    Attributes:
        views: six input views, compact: images uint8, silhouettes float16; B = 1.
        points: (P, 3) float16 world.
        distance: (P,) float16 signed, world units, positive inside.
    """

    views: NetworkViews
    points: Tensor
    distance: Tensor

    @property
    def usable(self) -> bool:
        """A sheet without volume has no inside to learn, and an object that no view frames cannot be seen."""
        return int((self.distance > -0.02).sum()) > 100 and bool((self.views.silhouette[:, :, 0] > 0.5).any())


def input_views(rig: shards.Arrays, name: str) -> ViewSet:
    """The first six views of a rig (its rgba, c2w and K), as a user brings them."""
    images = torch.from_numpy(rig["rgba"][:INPUTS]).permute(0, 3, 1, 2).float() / 255.0
    linear = torch.cat([linear_from_srgb(images[:, :3]), images[:, 3:]], dim=1)
    return ViewSet(linear, shards.cameras(rig)[:INPUTS], torch.ones(len(linear)), name)


def load_occupancy(path: Path) -> PointSample:
    """Signed distances around the object of one `rig_<k>.npz`."""
    # What is asked for; decompressing all would take three times as long.
    arrays = shards.arrays(path, "rgba", "c2w", "K")
    views = network_views(input_views(arrays, path.parent.name), PRESETS["small"].georm)
    compact = NetworkViews((views.images * 255.0).round().byte(), views.silhouette.half(), views.c2w, views.K)
    with np.load(path.with_name("occupancy.npz")) as file:
        return PointSample(compact, torch.from_numpy(file["points"]), torch.from_numpy(file["distance"]))


def expanded(views: NetworkViews) -> NetworkViews:
    """Compact views as the network takes them."""
    return NetworkViews(views.images.float() / 255.0, views.silhouette.float(), views.c2w, views.K)


def drop_views(generator: torch.Generator, share: float = 0.1) -> Tensor:
    """Indices of the input views that a step keeps: all six, or in a share of the steps 1 to 5 of them."""
    count = 6
    if float(torch.rand((), generator=generator)) < share:
        count = int(torch.randint(1, 6, (), generator=generator))
    return torch.randperm(6, generator=generator)[:count].sort().values


def rotation_z(angle: float) -> Tensor:
    cosine, sine = math.cos(angle), math.sin(angle)
    return torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def is_held_out(path: Path) -> bool:
    """Whether a sample's object only validates; its name decides, however many samples there are."""
    return zlib.crc32(path.parent.name.encode()) % HELD_OUT_EVERY == 0


def load_held_out(folder: Path) -> list[PointSample]:
    """The samples of a folder of shards that only validate GeoRM."""
    paths = [path for path in shards.rigs(folder) if is_held_out(path) and path.with_name("occupancy.npz").exists()]
    return [sample for sample in map(load_occupancy, paths) if sample.usable]


def add_arguments(parser: argparse.ArgumentParser, minutes: float, points: int, learning_rate: float) -> None:
    """The options of a stage that learns at points; such stages know `small` only, and run on the CPU."""
    options.add_arguments(parser, minutes, learning_rate, presets=("small",))
    parser.set_defaults(batch=2, weight_decay=0.01)
    parser.add_argument("--points", type=int, default=points, help="points an object")
