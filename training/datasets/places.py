"""Pictures of places without an object, from a data folder: views into its environments, and its textures."""

import math
from pathlib import Path

import OpenImageIO as oiio
import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.color import bytes_from_unit, srgb_from_linear

from ..random_numbers import uniform
from ..rendering.captures.surroundings import ground_textures
from ..rendering.manifest import read_manifest

SIDE = 192
"""Pixels."""

VIEWS = 24
"""Into each environment."""


def read_places(data: Path, seed: int) -> list[Tensor]:
    """(3, SIDE, SIDE) uint8 sRGB each: of the split `train` alone.

    Args:
        data: folder with `manifest.json`.
        seed: of where the views into the environments look.
    Raises:
        ArmError: a file cannot be read.
    """
    random = torch.Generator().manual_seed(seed)
    files = [data / entry["files"][0] for entry in read_manifest(data)["hdris"] if entry["split"] == "train"]
    places = [view for path in files for view in _views(_pixels(path), random)]
    for path in ground_textures(data, "train"):
        places.append(bytes_from_unit(interpolate(_pixels(path)[None], (SIDE, SIDE), mode="area")[0]))
    return places


def _views(environment: Tensor, random: torch.Generator) -> list[Tensor]:
    """Through lenses of 35° to 75°, level or down, exposed for what they see."""
    found = []
    for _ in range(VIEWS):
        azimuth, elevation = uniform(random, 0.0, 360.0), uniform(random, -15.0, 45.0)
        camera = orbit_camera(azimuth, elevation, 1.0, uniform(random, 35.0, 75.0), SIDE, SIDE)
        row, column = torch.meshgrid(torch.arange(SIDE) + 0.5, torch.arange(SIDE) + 0.5, indexing="ij")
        half = SIDE / 2.0
        rays = torch.stack([(column - half) / camera.K[0, 0], (half - row) / camera.K[1, 1], -torch.ones_like(row)])
        x, y, z = (camera.c2w[:3, :3] @ rays.flatten(1)).unflatten(1, (SIDE, SIDE))
        latitude = torch.atan2(z, (x * x + y * y).sqrt()) / (math.pi / 2.0)
        grid = torch.stack([torch.atan2(y, x) / math.pi, -latitude], dim=-1)[None]
        seen = grid_sample(environment[None], grid, mode="bilinear", padding_mode="border", align_corners=False)[0]
        exposed = seen * (0.25 / max(float(seen.clamp(max=4.0).mean()), 1e-4))
        found.append(bytes_from_unit(srgb_from_linear(exposed)))
    return found


def _pixels(path: Path) -> Tensor:
    """(3, H, W) float32, as they are stored."""
    buffer = oiio.ImageBuf(str(path))
    if not buffer.initialized or buffer.has_error:
        raise ArmError(f"{path}: not a readable picture; mend it or remove it from the manifest")
    return torch.from_numpy(buffer.get_pixels(oiio.FLOAT)).permute(2, 0, 1)[:3].expand(3, -1, -1).contiguous()
