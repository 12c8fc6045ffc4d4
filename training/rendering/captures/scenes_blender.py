"""Single pictures of training objects in changing surroundings, with their masks: what the cut-out network learns from.

`OUTPUT/<id>.npz`, N pictures of S x S: rgb (N, S, S, 3) uint8 sRGB, mask (N, S, S) uint8. The last one is the same
place without the object, its mask empty.
"""

import math
import tempfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import torch

from arm_blender.blender.asset.studio import aim_view_camera
from arm_blender.commands import interrupts
from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import Camera, intrinsics_from_fovy, look_at
from arm_blender.machine.quiet import STDOUT, silenced

from ..assets import Asset
from ..lighting_blender import add_area_lights, blender_environments
from ..passes_blender import SCRATCH, RenderConfig, byte_image, configure_cycles
from ..render_blender import illuminate
from ..scene_blender import (
    complete_materials,
    import_object,
    materials,
    normalise,
    reduce_to_brdf,
    triangles,
    vary_material,
)
from ..shards import save_arrays
from .ground_blender import add_block, add_clutter, add_ground, mark_object, random_surface, remove, render_linear


@dataclass(frozen=True)
class ScenesConfig:
    """What is rendered of an object."""

    views: int = 6
    """Pictures with the object."""
    seed: int = 0
    """Of everything that is drawn, together with the object's key."""


def answer(item: dict[str, Any], words: dict[str, Any]) -> dict[str, Any]:
    """Render one object's pictures, or say why not; a task of `side_by_side`.

    Args:
        item: an `Asset`, as a dictionary.
        words: "output", a folder; "render" and "scenes", the configs; "hdris" and "textures", files; "own_hdris",
            whether Blender's are drawn from as well.
    Returns:
        "key", and "dropped": the reason or None.
    """
    asset = Asset(**item)
    try:
        with silenced(STDOUT):
            arrays = render_scenes(
                asset,
                [Path(path) for path in words["hdris"]] + (blender_environments() if words["own_hdris"] else []),
                [Path(path) for path in words["textures"]],
                RenderConfig(**words["render"]),
                ScenesConfig(**words["scenes"]),
            )
        save_arrays(Path(words["output"]) / f"{asset.key}.npz", arrays)
    except (ArmError, RuntimeError) as error:  # Blender's operators raise RuntimeError.
        return {"key": asset.key, "dropped": str(error)}
    return {"key": asset.key, "dropped": None}


def render_scenes(
    asset: Asset, hdris: Sequence[Path], textures: Sequence[Path], render: RenderConfig, config: ScenesConfig
) -> dict[str, np.ndarray[Any, Any]]:
    """The arrays of one object's file.

    Raises:
        ArmError: it cannot be imported.
    """
    rng = np.random.default_rng([config.seed, zlib.crc32(asset.key.encode())])
    objects = import_object(Path(asset.path), asset.up)
    normalise(objects)
    vertices, _ = triangles(objects)
    complete_materials(objects)
    for material in materials(objects):
        reduce_to_brdf(material)
        if not asset.own_finish and rng.random() < 0.5:
            vary_material(material, rng)
    mark_object(objects)
    configure_cycles(render)
    bpy.context.scene.cycles.max_bounces = 1  # What an outline looks like is decided by the first bounce.
    low, high = vertices.min(0), vertices.max(0)
    rgb, masks = [], []
    with tempfile.TemporaryDirectory(dir=SCRATCH) as scratch:
        for view in range(config.views + 1):
            interrupts.check()
            if view < config.views:
                # Two pictures share a light: most of what a picture costs is to bring a new one in.
                if view % 2 == 0:
                    illuminate(hdris[int(rng.integers(len(hdris)))], rng)
                    lamps = _lamps(rng)
                things = _surroundings(low, high, textures, rng)
                aim_view_camera(bpy.context.scene, _camera(low, high, render.resolution, rng))
            else:
                things = _surroundings(low, high, textures, rng)
                for ob in objects:
                    ob.hide_render = True
            linear, mask = render_linear(Path(scratch) / "scene.exr")
            rgb.append(byte_image(linear, srgb=True))
            masks.append(mask)
            remove(things)
            if view % 2 == 1:
                for lamp in lamps:
                    bpy.data.objects.remove(lamp)
    return {"rgb": np.stack(rgb), "mask": np.stack(masks)}


def _lamps(rng: np.random.Generator) -> list[bpy.types.Object]:
    before = set(bpy.data.objects)
    add_area_lights(rng)
    return list(set(bpy.data.objects) - before)


def _camera(low: np.ndarray[Any, Any], high: np.ndarray[Any, Any], size: int, rng: np.random.Generator) -> Camera:
    """From any side, mostly from above, so that the object takes 15 to 110 % of the picture."""
    radius = float(np.linalg.norm(high - low)) / 2.0
    fovy = math.radians(rng.uniform(25.0, 70.0))
    fill = rng.uniform(0.2, 1.1) if rng.random() < 0.85 else rng.uniform(1.1, 1.6)
    distance = radius / (fill * math.tan(fovy / 2.0)) + 0.3 * radius
    elevation = math.radians(rng.uniform(-3.0, 60.0) if rng.random() < 0.9 else rng.uniform(60.0, 85.0))
    azimuth = rng.uniform(0.0, 2.0 * math.pi)
    eye = distance * torch.tensor(
        [
            math.cos(elevation) * math.sin(azimuth),
            -math.cos(elevation) * math.cos(azimuth),
            math.sin(elevation),
        ]
    )
    eye[2] = max(float(eye[2]), float(low[2]) + 0.05)
    # The further from the middle, the smaller the object is.
    loose = distance * math.tan(fovy / 2.0) * max(0.12, 0.7 - 0.6 * fill)
    target = torch.from_numpy(rng.uniform(-loose, loose, 3).astype(np.float32))
    c2w = look_at(eye, target)
    roll = rng.uniform(-0.15, 0.15)
    turned = torch.eye(4)
    turned[:2, :2] = torch.tensor([[math.cos(roll), -math.sin(roll)], [math.sin(roll), math.cos(roll)]])
    return Camera(c2w @ turned, intrinsics_from_fovy(fovy, size, size), size, size)


def _surroundings(
    low: np.ndarray[Any, Any], high: np.ndarray[Any, Any], textures: Sequence[Path], rng: np.random.Generator
) -> list[bpy.types.Object]:
    """A ground, often a table above another one, and a few things around; one picture in ten has nothing of it."""
    if rng.random() < 0.1:
        return []
    height, things = float(low[2]) - 1e-3, []
    if rng.random() < 0.5:
        size = float(np.exp(rng.uniform(math.log(2.5), math.log(8.0))))
        things.append(add_ground(random_surface(textures, size, rng), height, size, rng.uniform(0.0, 6.3)))
        if rng.random() < 0.7:
            below = height - rng.uniform(0.5, 4.0)
            things.append(add_ground(random_surface(textures, 40.0, rng), below, 40.0, rng.uniform(0.0, 6.3)))
    else:
        things.append(add_ground(random_surface(textures, 40.0, rng), height, 40.0, rng.uniform(0.0, 6.3)))
    if rng.random() < 0.5:
        things += add_clutter(textures, height, rng)
    if rng.random() < 0.2:
        azimuth, far = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(4.0, 9.0)
        place = (far * math.sin(azimuth), far * math.cos(azimuth), height - 0.01)
        things.append(add_block(random_surface(textures, 12.0, rng), "cube", (12.0, 0.2, 8.0), place, -azimuth))
    return things
