"""Light for data: an environment map, brought to one exposure, and area lights."""

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from arm_blender.blender.compat import shader_tree
from arm_blender.graphics.color import LUMINANCE


def set_world(hdri: Path, rotation_deg: float, strength: float) -> None:
    """Light the scene by an equirectangular HDRI, turned about Z."""
    world = bpy.data.worlds.new("environment")
    bpy.context.scene.world = world
    tree = shader_tree(world)
    image = tree.nodes.new("ShaderNodeTexEnvironment")
    image.image = bpy.data.images.load(str(hdri))
    image.image.colorspace_settings.name = "Linear Rec.709"
    coordinates, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Rotation"].default_value[2] = math.radians(rotation_deg)
    background = next(n for n in tree.nodes if n.type == "BACKGROUND")
    background.inputs["Strength"].default_value = strength
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], image.inputs["Vector"])
    tree.links.new(image.outputs["Color"], background.inputs["Color"])
    # Cycles rebuilds the importance map for each new environment; 256 texels are enough for noise at our sizes.
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 256


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
    """The CC0 environments that Blender ships for its viewport."""
    return sorted(Path(bpy.utils.system_resource("DATAFILES"), "studiolights", "world").glob("*.exr"))
