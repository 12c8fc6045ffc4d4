"""Samples that supervise a field at points: compact in memory, augmented when they are drawn."""

import argparse
import logging
import math
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from arm_blender.graphics.cameras import unproject
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.models.network_views import NetworkViews, network_views
from arm_blender.models.paper.reconstruction import SMALL
from arm_blender.structures import ViewSet

from .. import options
from ..rendering import shards

logger = logging.getLogger(__name__)

GLOSS_POINTS = 20_000

STRETCH = 0.25
"""Largest logarithm of the factor by which features' space is stretched along an axis."""

HELD_OUT_EVERY = 32
"""One object in so many validates."""


@dataclass(frozen=True)
class PointSample:
    """One rig of one object, and what is true at points of it.

    Attributes:
        views: six input views, compact: images uint8, silhouettes float16; B = 1.
        points: (P, 3) float16 world.
        target: (P, K) float16: signed distance (K = 1), or roughness and metallic (K = 2).
        solid: (P,) bool: on or in the object, so that it must stay in the box.
        depth: (1, 6, h, w) float16 of the visible surface beyond the origin's, world units; infinity is background.
        zero123plus: the rig is the Zero123++ one, turned about Z.
    """

    views: NetworkViews
    points: Tensor
    target: Tensor
    solid: Tensor
    depth: Tensor
    zero123plus: bool

    @property
    def usable(self) -> bool:
        """A sheet without volume has no inside to learn, and an object that no view frames cannot be seen."""
        return int(self.solid.sum()) > 100 and bool((self.views.silhouette[:, :, 0] > 0.5).any())


def load_occupancy(path: Path) -> PointSample:
    """Signed distances around the object of one `rig_<k>.npz`."""
    views, arrays, zero123plus = _input_views(path)
    occupancy = np.load(path.with_name("occupancy.npz"))
    points, distance = torch.from_numpy(occupancy["points"]), torch.from_numpy(occupancy["distance"])
    solid = distance > -0.02
    return PointSample(views, points, distance[:, None], solid, _input_depth(arrays), zero123plus)


def load_gloss(path: Path) -> PointSample:
    """Roughness and metallic at `GLOSS_POINTS` surface points, seen by any of the rig's views."""
    views, arrays, zero123plus = _input_views(path, "roughness", "metallic")
    points, target = [], []
    for index, camera in enumerate(shards.cameras(arrays)):
        # Pixels at the outline mix the object with what is behind it.
        rows, columns = np.nonzero((arrays["rgba"][index, ..., 3] == 255) & np.isfinite(arrays["depth"][index]))
        depth = torch.from_numpy(arrays["depth"][index][rows, columns].astype(np.float32))
        pixels = torch.from_numpy(np.stack([columns, rows], axis=1)).float() + 0.5
        points.append(unproject(pixels, depth, camera))
        finish = np.stack([arrays[name][index][rows, columns] for name in ("roughness", "metallic")], axis=1)
        target.append(torch.from_numpy(finish).float() / 255.0)
    points, target = torch.cat(points), torch.cat(target)
    chosen = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))[:GLOSS_POINTS]
    solid = torch.ones(len(chosen), dtype=torch.bool)
    return PointSample(views, points[chosen].half(), target[chosen].half(), solid, _input_depth(arrays), zero123plus)


def _input_views(path: Path, *more: str) -> tuple[NetworkViews, dict[str, np.ndarray], bool]:
    """The six input views of a rig, compact; its cameras, colour, depth and `more`; whether it is the Zero123++ rig."""
    # What is asked for; decompressing all would take three times as long.
    arrays = shards.arrays(path, "rgba", "depth", "c2w", "K", *more)
    cameras = shards.cameras(arrays)[:6]
    images = torch.from_numpy(arrays["rgba"][:6]).permute(0, 3, 1, 2).float() / 255.0
    linear = torch.cat([linear_from_srgb(images[:, :3]), images[:, 3:]], dim=1)
    views = network_views(ViewSet(linear, cameras, torch.ones(6), path.parent.name), SMALL)
    elevations = [math.degrees(math.asin(float(c.center[2] / c.center.norm()))) for c in cameras]
    alternating = all(abs(e - (20.0, -10.0)[i % 2]) < 0.5 for i, e in enumerate(elevations))
    compact = NetworkViews((views.images * 255.0).round().byte(), views.silhouette.half(), views.c2w, views.K)
    return compact, arrays, alternating


def _input_depth(arrays: dict[str, np.ndarray]) -> Tensor:
    """(1, 6, h, w) depth of the input views beyond the origin's, at the resolution of the network's features."""
    depth = torch.from_numpy(arrays["depth"][:6].astype(np.float32))
    depth = depth - torch.from_numpy(arrays["c2w"][:6, :3, 3]).norm(dim=1)[:, None, None]
    # Nearest: between the object and infinity there is nothing to interpolate.
    side = SMALL.encoder.image_size // 2
    return F.interpolate(depth[None], size=(side, side), mode="nearest-exact").half()


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


@dataclass(frozen=True)
class Batch:
    """What a step sees: B objects, augmented.

    Attributes:
        views: V views of each.
        points: (B, P, 3) world.
        target: (B, P, K) as in `PointSample`.
        depth: (B, V, h, w) as in `PointSample`.
    """

    views: NetworkViews
    points: Tensor
    target: Tensor
    depth: Tensor


def augmented(sample: PointSample, count: int, generator: torch.Generator, pictures: bool = True) -> Batch:
    """The object turned about Z, scaled, mirrored and exposed at random, and `count` of its points; B = 1.

    Args:
        pictures: that the views' images are pictures; otherwise features, and last a depth in world units. Features
            stay what they are where space is stretched: then every other object is, and its cameras are affine.
    """

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand((), generator=generator))

    views = expanded(sample.views) if pictures else sample.views
    c2w, K, images, silhouette, depth = views.c2w, views.K, views.images, views.silhouette, sample.depth.float()
    turn = uniform(0.0, 2.0 * math.pi)
    if sample.zero123plus and uniform(0.0, 1.0) < 0.6:
        # Users' rigs stand at 30, 90, ... degrees; this sample's rig is turned by what brings it there.
        eye = c2w[0, 0, :3, 3]
        turn = math.radians(30.0) - math.atan2(float(eye[0]), -float(eye[1]))
    linear = rotation_z(turn)
    if not pictures and uniform(0.0, 1.0) < 0.5:
        stretch = torch.tensor([uniform(-STRETCH, STRETCH) for _ in range(3)])
        linear = linear * (stretch - stretch.mean()).exp()  # Of determinant 1: distances stay about what they are.
    turned = sample.points[sample.solid].float() @ linear.T
    scale = min(1.0, 0.99 / float(turned.abs().amax())) * uniform(0.75, 1.0)
    c2w = c2w.clone()
    # So that a point's place in the camera, c2w[:3, :3].T @ (point - eye), is what it was; a rotation is its own.
    c2w[..., :3, :3] = torch.linalg.inv(linear).T @ c2w[..., :3, :3]
    c2w[..., :3, 3] = c2w[..., :3, 3] @ linear.T * scale
    chosen = torch.randint(len(sample.points), (count,), generator=generator)
    points = sample.points[chosen].float() @ linear.T * scale
    target = sample.target[chosen].float()
    if target.shape[1] == 1:
        target = target * scale  # A distance.
    if uniform(0.0, 1.0) < 0.5:
        # Across the plane y = 0, which takes the Zero123++ rig's azimuths 30, 90, ... to themselves, heights and all.
        world, camera = torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0])), torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0]))
        c2w, points = world @ c2w @ camera, points * torch.tensor([1.0, -1.0, 1.0])
        images, silhouette, depth, K = images.flip(-1), silhouette.flip(-1), depth.flip(-1), K.clone()
        K[..., 0, 2] = silhouette.shape[-1] - K[..., 0, 2]
    if pictures:
        color, alpha = images[:, :, :3], images[:, :, 3:]
        color = torch.where(alpha > 0.02, (color * uniform(0.7, 1.3)).clamp(0.0, 1.0), color)
        images = torch.cat([color, alpha], dim=2)
    else:
        images = torch.cat([images[:, :, :-1], images[:, :, -1:] * scale], dim=2)
    return Batch(NetworkViews(images, silhouette, c2w, K), points[None], target[None], depth * scale)


def batched(samples: list[Batch], keep: Tensor) -> Batch:
    """Stack samples, keeping only the views of index `keep`."""
    parts = [
        torch.cat([getattr(sample.views, name)[:, keep] for sample in samples])
        for name in ("images", "silhouette", "c2w", "K")
    ]
    points, target = torch.cat([s.points for s in samples]), torch.cat([s.target for s in samples])
    return Batch(NetworkViews(*parts), points, target, torch.cat([s.depth[:, keep] for s in samples]))


def depth_loss(predicted: Tensor, truth: Tensor) -> Tensor:
    """Mean absolute error over the object's pixels, world units: the paper's depth term, for what the views show.

    Args:
        predicted: (B, V, 1, h, w). truth: (B, V, h, w), infinity is background.
    """
    seen = truth.isfinite()
    return (predicted[:, :, 0] - truth)[seen].abs().clamp(max=1.0).mean() if bool(seen.any()) else predicted.sum() * 0.0


def is_held_out(path: Path) -> bool:
    """Whether a sample's object only validates; its name decides, however many samples there are."""
    return zlib.crc32(path.parent.name.encode()) % HELD_OUT_EVERY == 0


def load_held_out(folder: Path) -> list[PointSample]:
    """The samples of a folder of shards that only validate GeoRM."""
    paths = [path for path in shards.rigs(folder) if is_held_out(path) and path.with_name("occupancy.npz").exists()]
    return [sample for sample in map(load_occupancy, paths) if sample.usable]


def add_point_arguments(parser: argparse.ArgumentParser, minutes: float, points: int, learning_rate: float) -> None:
    """The options of a stage that learns at points; such stages know `small` only, and run on the CPU."""
    options.add_arguments(parser, minutes, learning_rate, presets=("small",))
    parser.set_defaults(batch=2, weight_decay=0.01)
    parser.add_argument("--points", type=int, default=points, help="points an object")


def add_arguments(parser: argparse.ArgumentParser, minutes: float, points: int, learning_rate: float) -> None:
    """The options of a stage that learns from pictures at points, with that stage's defaults."""
    add_point_arguments(parser, minutes, points, learning_rate)
    parser.add_argument("--data", type=Path, help="folder with manifest.json; every other sample is a real object's")
    parser.add_argument("--look-once", action="store_true", help="find the views' features once, and learn the rest")
    parser.add_argument("--no-features", action="store_true", help="as --look-once, with geometry and colours alone")
    parser.add_argument("--freeze", nargs="*", default=[], help="parts of the model that stay as they are")


class SampleCache:
    """Samples of a folder in memory, about 2 MB each; what is rendered meanwhile joins at `refresh`.

    Attributes:
        favoured: names of objects that every other draw takes.
        pictures: as of `augmented`, of what `load` returns.
        held_out: samples of objects that are never drawn.
    Raises:
        ArmError: there is nothing to draw from.
    """

    def __init__(
        self,
        folder: Path,
        load: Callable[[Path], PointSample],
        favoured: frozenset[str] = frozenset(),
        pictures: bool = True,
    ) -> None:
        self.folder, self.load, self.favoured, self.pictures = folder, load, favoured, pictures
        self.loaded: dict[Path, PointSample] = {}
        self.checked = -math.inf
        self.refresh()
        if not self.training:
            raise shards.nothing_prepared(folder)

    def refresh(self) -> None:
        """Read new files; at most once a minute."""
        if time.monotonic() - self.checked < 60.0:
            return
        self.checked = time.monotonic()
        for path in shards.rigs(self.folder):
            if path not in self.loaded and path.with_name("occupancy.npz").exists():
                self.loaded[path] = self.load(path)
        usable = {path: sample for path, sample in self.loaded.items() if sample.usable}
        self.held_out = [sample for path, sample in usable.items() if is_held_out(path)]
        training = {path: sample for path, sample in usable.items() if not is_held_out(path)}
        self.training = list(training.values())
        self.preferred = [sample for path, sample in training.items() if path.parent.name in self.favoured]
        logger.info("%d samples to train on, %d held out", len(self.training), len(self.held_out))

    def draw(self, generator: torch.Generator) -> PointSample:
        """Any sample; every other time one of a favoured object, where there are such."""
        prefer = self.preferred and float(torch.rand((), generator=generator)) < 0.5
        samples = self.preferred if prefer else self.training
        return samples[int(torch.randint(len(samples), (), generator=generator))]

    def batch(self, count: int, points: int, generator: torch.Generator) -> Batch:
        """What a step sees: `count` samples, augmented, at `points` points each, all with the same views kept."""
        self.refresh()
        picks = [self.draw(generator) for _ in range(count)]
        moved = [augmented(sample, points, generator, self.pictures) for sample in picks]
        return batched(moved, drop_views(generator))
