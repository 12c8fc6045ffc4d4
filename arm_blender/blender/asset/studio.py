"""Scenes to look at an asset in: a camera that frames it, what lights it, and scenes that leave no trace."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...errors import InputImageError
from ..compat import shader_tree

if TYPE_CHECKING:  # It brings torch, which takes seconds.
    from ...graphics.cameras import Camera

FIELD_OF_VIEW_DEG = 30.0

IMPORTANCE_MAP_SIZE = 256
"""Pixels across. Blender's own choice is the size of the environment, which costs two seconds for every new one."""

_ROTATION = "Rotation of the environment"
"""The node of a world of ours that turns it."""

_INTERFACE = {"window_managers", "screens", "workspaces"}


@contextmanager
def temporary_scene(name: str) -> Iterator[bpy.types.Scene]:
    """A new scene; it and every datablock that is made meanwhile are removed at the end, also after an error."""
    before = _datablocks()
    scene = bpy.data.scenes.new(name)
    try:
        yield scene
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.batch_remove(_datablocks() - before)


def light_by_environment(scene: bpy.types.Scene, path: Path, rotation_deg: float = 0.0) -> bpy.types.World:
    """Light `scene` by an equirectangular environment map, and by nothing else that it adds.

    Args:
        rotation_deg: as of `turn_environment`.
    Returns:
        the world, which is the scene's.
    Raises:
        InputImageError: Blender cannot read the map.
    """
    world = bpy.data.worlds.new(path.stem)
    tree = shader_tree(world)
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputWorld")
    background = tree.nodes.new("ShaderNodeBackground")
    environment = tree.nodes.new("ShaderNodeTexEnvironment")
    try:
        environment.image = bpy.data.images.load(str(path), check_existing=False)
        if 0 in environment.image.size:  # Blender takes any file for a picture, and lights by pink what it cannot read.
            raise RuntimeError(f"{path} has no pixels")
    except RuntimeError as error:
        raise InputImageError(f"{path}: Blender cannot read this environment map; give a .hdr or .exr file") from error
    place = tree.nodes.new("ShaderNodeTexCoord")
    turned = tree.nodes.new("ShaderNodeMapping")
    turned.name = _ROTATION
    tree.links.new(place.outputs["Generated"], turned.inputs["Vector"])
    tree.links.new(turned.outputs["Vector"], environment.inputs["Vector"])
    tree.links.new(environment.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    if hasattr(world, "cycles"):
        world.cycles.sampling_method = "MANUAL"
        world.cycles.sample_map_resolution = IMPORTANCE_MAP_SIZE
    if hasattr(world, "sun_threshold"):
        world.sun_threshold = 0.0  # Else Eevee makes one sun of everything bright, however many lamps the map has.
    turn_environment(world, rotation_deg)
    scene.world = world
    return world


def pack_environment(world: bpy.types.World) -> None:
    """Keep the map of a world of `light_by_environment` in the .blend."""
    for node in shader_tree(world).nodes:
        if node.type == "TEX_ENVIRONMENT":
            node.image.pack()


def turn_environment(world: bpy.types.World, rotation_deg: float) -> bool:
    """Turn what lights a scene about the vertical, counter-clockwise seen from above; False where it is not of ours."""
    turned = world.node_tree.nodes.get(_ROTATION) if world.node_tree is not None else None
    if turned is None:
        return False
    # The node turns the directions that are looked up: the environment goes the other way.
    turned.inputs["Rotation"].default_value[2] = -math.radians(rotation_deg)
    return True


def light_softly(scene: bpy.types.Scene, center: Vector, radius: float) -> None:
    """A grey sky and one large lamp in front of the object, up and to the left of it."""
    world = bpy.data.worlds.new("Soft light")
    background = next(node for node in shader_tree(world).nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (0.6, 0.6, 0.6, 1.0)
    scene.world = world
    lamp = bpy.data.lights.new("Soft key", "AREA")
    lamp.size = 3.0 * radius
    lamp.energy = 120.0 * radius**2  # The light that arrives stays the same for an object of any size.
    holder = bpy.data.objects.new(lamp.name, lamp)
    offset = 3.0 * radius * Vector((-0.6, -0.6, 0.8))
    holder.location = center + offset
    holder.rotation_euler = (-offset).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(holder)


def bounding_sphere(objects: Sequence[bpy.types.Object]) -> tuple[Vector, float]:
    """World-space centre and radius of a sphere around the vertices of mesh `objects`, before their modifiers.

    The centre is that of the bounding box; the radius is never 0.
    """
    points = []
    for item in objects:
        flat = np.empty(3 * len(item.data.vertices), dtype=np.float32)
        item.data.vertices.foreach_get("co", flat)
        matrix = np.array(item.matrix_world)
        points.append(flat.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
    world = np.concatenate(points)
    center = (world.min(axis=0) + world.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(world - center, axis=1).max())
    return Vector(center.tolist()), max(radius, 1e-6)


def add_camera(
    scene: bpy.types.Scene, center: Vector, radius: float, azimuth_deg: float, elevation_deg: float
) -> bpy.types.Object:
    """A camera that has the whole sphere in its square picture.

    Args:
        center: of the sphere, world.
        radius: of the sphere, world units.
        azimuth_deg: 0 is Blender's front (-Y); grows counter-clockwise seen from above.
        elevation_deg: above the horizon.
    """
    lens = bpy.data.cameras.new("Camera")
    lens.angle = math.radians(FIELD_OF_VIEW_DEG)
    camera = bpy.data.objects.new(lens.name, lens)
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    towards = Vector(
        (
            math.sin(azimuth) * math.cos(elevation),
            -math.cos(azimuth) * math.cos(elevation),
            math.sin(elevation),
        )
    )
    distance = 1.05 * radius / math.sin(math.radians(FIELD_OF_VIEW_DEG) / 2.0)
    lens.clip_start = 0.01 * (distance - radius)
    lens.clip_end = 10.0 * (distance + radius)
    camera.location = center + distance * towards
    camera.rotation_euler = (-towards).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(camera)
    scene.camera = camera
    return camera


def add_view_camera(scene: bpy.types.Scene, camera: "Camera") -> bpy.types.Object:
    """A pinhole camera of ours, of square pixels, as the scene's camera and its resolution."""
    lens = bpy.data.cameras.new("Camera")
    lens.sensor_fit, lens.clip_start = "HORIZONTAL", 0.01
    holder = bpy.data.objects.new(lens.name, lens)
    scene.collection.objects.link(holder)
    scene.camera = holder
    aim_view_camera(scene, camera)
    return holder


def aim_view_camera(scene: bpy.types.Scene, camera: "Camera") -> None:
    """Bring the camera of `add_view_camera` to where another of ours is."""
    scene.camera.matrix_world = Matrix(camera.c2w.tolist())
    lens = scene.camera.data
    lens.angle = 2.0 * math.atan(camera.width / (2.0 * float(camera.K[0, 0])))
    # In widths, of the picture against the optical axis.
    lens.shift_x = 0.5 - float(camera.K[0, 2]) / camera.width
    lens.shift_y = (float(camera.K[1, 2]) - 0.5 * camera.height) / camera.width
    scene.render.resolution_x, scene.render.resolution_y = camera.width, camera.height


def _datablocks() -> set[bpy.types.ID]:
    """Every datablock of the open file but those of the interface and the one render result that Blender keeps."""
    collections = (
        getattr(bpy.data, prop.identifier)
        for prop in bpy.data.bl_rna.properties
        if prop.type == "COLLECTION" and prop.identifier not in _INTERFACE
    )
    return {item for blocks in collections for item in blocks if getattr(item, "type", "") != "RENDER_RESULT"}
