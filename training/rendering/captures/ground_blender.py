"""A scene around an object: a ground that it stands on, things beside it, and a pass that tells it from both."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from arm_blender.blender.compat import shader_tree

from ..passes_blender import byte_image, channels, read_layers
from ..scene_blender import materials

COVERAGE = "arm_object"
"""The AOV that is 1 where a pixel shows the object."""


@dataclass(frozen=True)
class Surface:
    """What a ground, a wall or a thing is made of."""

    texture: Path | None = None
    """Of the base colour; None for one colour."""
    color: tuple[float, float, float] = (0.5, 0.5, 0.5)
    """Linear; without a texture."""
    repeats: float = 1.0
    """Of the texture along a side. More than one shows in a picture, and looks alike to who matches features."""
    roughness: float = 0.6


def mark_object(objects: list[bpy.types.Object]) -> None:
    """Have the objects' materials write `COVERAGE`, and the passes with it."""
    for material in materials(objects):
        tree = shader_tree(material) if material.node_tree is None else material.node_tree
        aov = tree.nodes.new("ShaderNodeOutputAOV")
        aov.aov_name = COVERAGE
        aov.inputs["Value"].default_value = 1.0
    own = bpy.context.view_layer.aovs.add()
    own.name, own.type = COVERAGE, "VALUE"


def render_linear(path: Path) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """The scene from its camera: (H, W, 3) linear Rec.709 and (H, W) uint8, how much of a pixel is the object.

    Args:
        path: of an EXR that is written on the way.
    """
    scene = bpy.context.scene
    scene.render.filepath, scene.render.film_transparent = str(path), False
    bpy.ops.render.render(write_still=True)
    layers = read_layers(path)
    coverage = channels(layers, COVERAGE, "XV")[..., 0]
    return channels(layers, "Combined", "RGB"), byte_image(coverage, srgb=False)


def add_ground(surface: Surface, height: float, size: float, turn: float = 0.0) -> bpy.types.Object:
    """A square of that many world units a side around the origin, at a height, turned about Z by radians."""
    bpy.ops.mesh.primitive_plane_add(size=size, location=(0.0, 0.0, height), rotation=(0.0, 0.0, turn))
    return _dressed(bpy.context.object, surface)


def add_block(
    surface: Surface, kind: str, size: tuple[float, float, float], place: tuple[float, float, float], turn: float
) -> bpy.types.Object:
    """A "cube", "cylinder" or "sphere" whose box has that size, its bottom's centre at a place."""
    add = {
        "cube": bpy.ops.mesh.primitive_cube_add,
        "cylinder": bpy.ops.mesh.primitive_cylinder_add,
        "sphere": bpy.ops.mesh.primitive_uv_sphere_add,
    }[kind]
    x, y, z = place
    add(location=(x, y, z + size[2] / 2.0), rotation=(0.0, 0.0, turn))
    thing = bpy.context.object
    thing.scale = tuple(side / 2.0 for side in size)  # Primitives are two units wide.
    if kind == "sphere":
        bpy.ops.object.shade_smooth()
    return _dressed(thing, surface)


def _dressed(thing: bpy.types.Object, surface: Surface) -> bpy.types.Object:
    material = bpy.data.materials.new("surroundings")
    tree = shader_tree(material)
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = surface.roughness
    shader.inputs["Base Color"].default_value = (*surface.color, 1.0)
    if surface.texture is not None:
        picture = tree.nodes.new("ShaderNodeTexImage")
        picture.image = bpy.data.images.load(str(surface.texture), check_existing=True)
        place, scale = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
        scale.inputs["Scale"].default_value = (surface.repeats,) * 3
        tree.links.new(place.outputs["UV"], scale.inputs["Vector"])
        tree.links.new(scale.outputs["Vector"], picture.inputs["Vector"])
        tree.links.new(picture.outputs["Color"], shader.inputs["Base Color"])
    thing.data.materials.append(material)
    return thing


def add_clutter(
    textures: Sequence[Path], height: float, rng: np.random.Generator, nearest: float = 2.2
) -> list[bpy.types.Object]:
    """One to four things that stand on a ground of that height around the origin, at least `nearest` away."""
    things = []
    for _ in range(int(rng.integers(1, 5))):
        azimuth, far = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(nearest, 7.0)
        sides = rng.uniform(0.15, 1.5, 3) * (0.5 if far < 3.5 else 1.0)
        place = (far * math.sin(azimuth), far * math.cos(azimuth), height)
        kind = ("cube", "cylinder", "sphere")[int(rng.integers(3))]
        surface = random_surface(textures, float(sides.max()), rng)
        things.append(add_block(surface, kind, tuple(sides.tolist()), place, rng.uniform(0.0, 6.3)))
    return things


def random_surface(textures: Sequence[Path], size: float, rng: np.random.Generator) -> Surface:
    """Of a thing that is `size` units wide: a texture whose tile is 1 to 8 units wide, or one colour."""
    roughness = float(rng.uniform(0.1, 1.0))
    if not textures or rng.random() < 0.25:
        grey, tint = rng.uniform(0.02, 0.9), rng.uniform(0.7, 1.0, 3)
        return Surface(color=tuple((grey * tint).tolist()), roughness=roughness)
    tile = float(np.exp(rng.uniform(0.0, math.log(8.0))))
    return Surface(textures[int(rng.integers(len(textures)))], repeats=max(size / tile, 0.3), roughness=roughness)


def remove(things: list[bpy.types.Object]) -> None:
    """Take things and what they are made of out of the scene."""
    for thing in things:
        used = [slot.material for slot in thing.material_slots]
        mesh = thing.data
        bpy.data.objects.remove(thing)
        bpy.data.meshes.remove(mesh)
        for material in used:
            bpy.data.materials.remove(material)
