"""A Blender scene for data: import one object, normalise it, light it, and give its materials AOVs.

The albedo, roughness and metallic of a view come from the sockets of the Principled BSDF through AOVs, in the same
Cycles pass as the lit image: the DiffCol pass is not albedo (it is scaled for dielectrics and black for metal).
"""

import logging
import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from arm_blender.blender.compat import shader_tree
from arm_blender.errors import ArmError
from arm_blender.graphics.color import LUMINANCE

from .metals import METALS

logger = logging.getLogger(__name__)

AOVS = {
    "arm_albedo": ("COLOR", "Base Color"),
    "arm_roughness": ("VALUE", "Roughness"),
    "arm_metallic": ("VALUE", "Metallic"),
}
"""AOV name: its type and the socket of the Principled BSDF that feeds it."""


def import_object(path: Path) -> list[bpy.types.Object]:
    """Empty the scene, import a GLB, glTF or OBJ (Z up, as Google Scanned Objects), return its objects."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if path.suffix.lower() in {".glb", ".gltf"}:
        bpy.ops.import_scene.gltf(filepath=str(path))
    elif path.suffix.lower() == ".obj":
        bpy.ops.wm.obj_import(filepath=str(path), forward_axis="Y", up_axis="Z")
    else:
        raise ArmError(f"{path}: cannot import {path.suffix or 'a file without extension'}; give GLB, glTF or OBJ")
    objects = list(bpy.data.objects)
    # The glTF importer hides nothing of its own accord, but keeps icospheres that display bones.
    for ob in [o for o in objects if o.name.startswith("Icosphere") and not o.data.materials]:
        bpy.data.objects.remove(ob)
    return [o for o in bpy.data.objects if o.type == "MESH" and not o.hide_render]


def triangles(objects: list[bpy.types.Object]) -> tuple[np.ndarray, np.ndarray]:
    """World-space triangles of the evaluated objects: vertices (N, 3) float32, faces (F, 3) int64."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    vertices, faces, offset = [], [], 0
    for ob in objects:
        evaluated = ob.evaluated_get(depsgraph)
        mesh = evaluated.to_mesh()
        mesh.calc_loop_triangles()
        co = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("co", co)
        tri = np.empty(len(mesh.loop_triangles) * 3, np.int32)
        mesh.loop_triangles.foreach_get("vertices", tri)
        matrix = np.array(ob.matrix_world, np.float32)
        vertices.append(co.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
        faces.append(tri.reshape(-1, 3).astype(np.int64) + offset)
        offset += len(vertices[-1])
        evaluated.to_mesh_clear()
    if not faces or not sum(map(len, faces)):
        raise ArmError("the file holds no triangles")
    return np.concatenate(vertices), np.concatenate(faces)


def normalise(objects: list[bpy.types.Object]) -> None:
    """Centre the bounding box at the origin and scale its longest side to 2."""
    bpy.context.view_layer.update()
    vertices, faces = triangles(objects)
    used = vertices[np.unique(faces)]
    low, high = used.min(0), used.max(0)
    extent = float((high - low).max())
    if not math.isfinite(extent) or extent < 1e-9:
        raise ArmError("the object has no extent")
    root = bpy.data.objects.new("root", None)
    bpy.context.scene.collection.objects.link(root)
    for ob in [o for o in bpy.data.objects if o.parent is None and o is not root]:
        ob.parent = root
    root.matrix_world = Matrix.Scale(2.0 / extent, 4) @ Matrix.Translation(-Vector((low + high) / 2.0))
    bpy.context.view_layer.update()


def principled(material: bpy.types.Material) -> bpy.types.Node | None:
    """The material's Principled BSDF, None where it has none."""
    tree = material.node_tree
    return next((n for n in tree.nodes if n.type == "BSDF_PRINCIPLED"), None) if tree else None


def make_opaque(material: bpy.types.Material) -> None:
    """Transmission and transparency are outside of the paper's BRDF; they would end up in the albedo's truth."""
    node = principled(material)
    if node is None:
        return
    for name, value in (
        ("Transmission Weight", 0.0),
        ("Coat Weight", 0.0),
        ("Sheen Weight", 0.0),
        ("Emission Strength", 0.0),
    ):
        socket = node.inputs[name]
        for link in list(socket.links):
            material.node_tree.links.remove(link)
        socket.default_value = value


def vary_material(material: bpy.types.Material, rng: np.random.Generator) -> None:
    """A random finish for an object that has none of its own: a dielectric, or for one in four a real metal."""
    node = principled(material)
    if node is None:
        return
    for name in ("Roughness", "Metallic"):
        for link in list(node.inputs[name].links):
            material.node_tree.links.remove(link)
    metal = rng.random() < 0.25
    node.inputs["Metallic"].default_value = float(metal)
    node.inputs["Roughness"].default_value = float(rng.uniform(0.08, 0.6) if metal else rng.uniform(0.15, 1.0))
    if metal and not node.inputs["Base Color"].is_linked and rng.random() < 0.7:
        node.inputs["Base Color"].default_value = (*METALS[rng.integers(len(METALS))], 1.0)


def add_aovs() -> None:
    """Route the sockets of every Principled BSDF to AOVs and switch the passes on."""
    for material in bpy.data.materials:
        node = principled(material)
        if node is None:
            continue
        tree = material.node_tree
        for name, (kind, socket_name) in AOVS.items():
            aov = tree.nodes.new("ShaderNodeOutputAOV")
            aov.aov_name = name
            source, target = node.inputs[socket_name], aov.inputs["Color" if kind == "COLOR" else "Value"]
            if source.is_linked:
                tree.links.new(source.links[0].from_socket, target)
            else:
                target.default_value = tuple(source.default_value) if kind == "COLOR" else source.default_value
    layer = bpy.context.view_layer
    layer.use_pass_z = layer.use_pass_normal = True
    for name, (kind, _) in AOVS.items():
        aov = layer.aovs.add()
        aov.name, aov.type = name, kind


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


def blender_environments() -> list[Path]:
    """The CC0 environments that Blender ships for its viewport."""
    return sorted(Path(bpy.utils.system_resource("DATAFILES"), "studiolights", "world").glob("*.exr"))
