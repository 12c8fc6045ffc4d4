"""Samples that supervise what a network renders: all views of a rig with their true mask, depth and normals."""

import math
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from arm_blender.graphics.cameras import Camera
from arm_blender.models.network_views import NetworkViews, PictureConfig, network_views

from ..losses import SurfaceMaps
from ..rendering import shards
from ..volume_rendering import Rays, pixel_rays
from .point_samples import input_views, rotation_z


@dataclass(frozen=True)
class ViewSample:
    """One rig of one object, V views of S x S pixels.

    Attributes:
        inputs: the first six views as the network takes them; B = 1.
        c2w: (V, 4, 4).
        K: (V, 3, 3) pixels.
        truth: of all V views, at their resolution.
        vertices: (N, 3) of the true surface, world: what must stay in the box.
    """

    inputs: NetworkViews
    c2w: Tensor
    K: Tensor
    truth: SurfaceMaps
    vertices: Tensor


Sample = TypeVar("Sample", bound=ViewSample)


@dataclass(frozen=True)
class Crop:
    """A square window of each view.

    Attributes:
        rays: of its pixels, row by row: V of size * size.
        cosine: (V, size * size) of the angle between ray and view axis.
        truth: (V, size, size) maps.
    """

    rays: Rays
    cosine: Tensor
    truth: SurfaceMaps


def load(path: Path, config: PictureConfig) -> ViewSample:
    """The sample of one `rig_<k>.npz`, for networks of `config`."""
    names = ("rgba", "depth", "normal", "c2w", "K")
    arrays = shards.arrays(path, *names)
    views = input_views(arrays, path.parent.name)
    truth = SurfaceMaps(
        torch.from_numpy(arrays["rgba"][..., 3]).float() / 255.0,
        torch.from_numpy(arrays["depth"].astype(np.float32)),
        torch.from_numpy(arrays["normal"]).permute(0, 3, 1, 2).float() / 127.0,
    )
    c2w, K = (torch.from_numpy(arrays[name]).float() for name in ("c2w", "K"))
    vertices = shards.read_mesh(path.with_name("mesh.npz")).vertices
    return ViewSample(network_views(views, config), c2w, K, truth, vertices)


def moved(sample: Sample, generator: torch.Generator) -> Sample:
    """The object turned about Z and made smaller at random, with its cameras and its truth; it stays in the box."""
    angle, shrink = torch.rand(2, generator=generator).tolist()
    turn = rotation_z(2.0 * math.pi * angle)
    vertices = sample.vertices @ turn.T
    reach = float(vertices.abs().max()) if len(vertices) else 0.0
    scale = min(1.0, 0.99 / max(reach, 1e-6)) * (0.75 + 0.25 * shrink)

    def carried(c2w: Tensor) -> Tensor:
        c2w = c2w.clone()
        c2w[..., :3, :] = turn @ c2w[..., :3, :]
        c2w[..., :3, 3] = scale * c2w[..., :3, 3]
        return c2w

    normal = torch.einsum("ij,vjhw->vihw", turn, sample.truth.normal)
    truth = SurfaceMaps(sample.truth.mask, scale * sample.truth.depth, normal)
    inputs = replace(sample.inputs, c2w=carried(sample.inputs.c2w))
    return replace(sample, inputs=inputs, c2w=carried(sample.c2w), truth=truth, vertices=scale * vertices)


def on_device(value: Any, device: torch.device) -> Any:
    """The same, with every tensor that it is made of on a device; of samples, or of what these consist of."""
    if isinstance(value, Tensor):
        return value.to(device)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{part.name: on_device(getattr(value, part.name), device) for part in fields(value)})
    return value


def cameras(sample: ViewSample, chosen: Tensor, side: int) -> list[Camera]:
    """Those of the views of index `chosen`, with `side` pixels."""
    own = sample.truth.mask.shape[-1]
    found = (Camera(sample.c2w[index], sample.K[index], own, own) for index in chosen.tolist())
    return [camera.resized(side, side) for camera in found]


def resampled(maps: Tensor, chosen: Tensor, side: int) -> Tensor:
    """Maps (V, C, S, S) of the views of index `chosen`, with `side` pixels: the nearest ones, as in `crop`."""
    return F.interpolate(maps[chosen.to(maps.device)], size=(side, side), mode="nearest-exact")


def crop(sample: ViewSample, chosen: Tensor, side: int, size: int, generator: torch.Generator) -> Crop:
    """A window at random in each of the views of index `chosen`.

    Args:
        side: pixels that the whole image has at the resolution rendered; the truth is that of the nearest pixel.
        size: pixels a side of the window, at most `side`.
    """
    own = sample.truth.mask.shape[-1]
    low = (torch.rand(len(chosen), 2, generator=generator) * (side - size + 1)).floor().to(sample.c2w.device)
    steps, chosen = torch.arange(size, device=low.device) + 0.5, chosen.to(low.device)
    x, y = ((low[:, axis, None] + steps) * (own / side) for axis in (0, 1))  # (V, size) in the view's own pixels
    pixels = torch.stack([x[:, None].expand(-1, size, -1), y[..., None].expand(-1, -1, size)], dim=-1)
    c2w = sample.c2w[chosen]
    rays = pixel_rays(pixels.flatten(1, 2), c2w, sample.K[chosen])
    cosine = (rays.directions * -c2w[:, None, :3, 2]).sum(dim=-1)
    view, row, column = chosen[:, None, None], y.long()[..., None], x.long()[:, None]
    truth = SurfaceMaps(
        sample.truth.mask[view, row, column],
        sample.truth.depth[view, row, column],
        sample.truth.normal.movedim(1, -1)[view, row, column].movedim(-1, 1),
    )
    return Crop(rays, cosine, truth)
