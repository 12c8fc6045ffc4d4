"""Light for data: an environment map, brought to one exposure, and area lights."""

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from arm_blender.blender.asset.studio import light_by_environment
from arm_blender.blender.relight.environments import shipped_environments
from arm_blender.graphics.color import LUMINANCE


def set_world(hdri: Path, rotation_deg: float, strength: float) -> None:
    """Light the scene by an equirectangular HDRI, turned about Z, clockwise seen from above."""
    world = light_by_environment(bpy.context.scene, hdri, -rotation_deg)
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Strength"].default_value = strength


def mean_radiance(hdri: Path) -> float:
    """Mean luminance of an environment over the sphere, to bring all of them to one exposure."""
    image = bpy.data.images.load(str(hdri))
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    luminance = pixels.reshape(height, width, 4)[..., :3] @ np.array(LUMINANCE, np.float32)
    weight = np.sin((np.arange(height) + 0.5) / height * math.pi)
    return float((luminance.mean(1) * weight).sum() / weight.sum())


def add_area_lights(rng: np.random.Generator) -> list[dict[str, float]]:
    """None, one or two area lights at random, aimed at the origin; what each was drawn as.

    Each brings the origin 0.5 to 3 of irradiance, where the environment brings about pi: a shadow that is seen, and
    no picture that is white all over.
    """
    lights = []
    for _ in range(int(rng.integers(3))):
        azimuth, height = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-0.2, 1.0)
        distance, size, irradiance = rng.uniform(3.0, 6.0), rng.uniform(0.3, 2.5), rng.uniform(0.5, 3.0)
        ring = math.sqrt(1.0 - height * height)
        place = distance * Vector((ring * math.sin(azimuth), -ring * math.cos(azimuth), height))
        lamp = bpy.data.lights.new("area", "AREA")
        lamp.size = size
        lamp.energy = irradiance * math.pi * distance**2  # A Lambertian lamp of P watts has P / pi on its axis.
        lamp.color = tuple(rng.uniform(0.8, 1.0, 3))
        holder = bpy.data.objects.new(lamp.name, lamp)
        holder.location, holder.rotation_euler = place, place.to_track_quat("Z", "Y").to_euler()
        holder.visible_camera = False
        bpy.context.scene.collection.objects.link(holder)
        lights.append({"distance": distance, "size": size, "irradiance": irradiance})
    return lights


def blender_environments() -> list[Path]:
    """The environments that Blender ships for its viewport."""
    return list(shipped_environments().values())
