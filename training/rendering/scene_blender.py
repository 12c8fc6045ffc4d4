"""A Blender scene for data: import one object, normalise it, and give its materials AOVs.

The albedo, roughness and metallic of a view come from the sockets of the Principled BSDF through AOVs, in the same
Cycles pass as the lit image: the DiffCol pass is not albedo (it is scaled for dielectrics and black for metal).
"""

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from arm_blender.blender.compat import reason, shader_tree
from arm_blender.errors import ArmError

from .metals import METALS

AOVS = {
    "arm_albedo": ("COLOR", "Base Color"),
    "arm_roughness": ("VALUE", "Roughness"),
    "arm_metallic": ("VALUE", "Metallic"),
}
"""AOV name: its type and the socket of the Principled BSDF that feeds it."""


def import_object(path: Path, up: str = "Y") -> list[bpy.types.Object]:
    """Empty the scene, import a GLB, glTF, OBJ, FBX or USD, return its meshes.

    None of these formats runs code on import; a .blend, which may, is not taken. What a file brings as a driver or
    text stays dead: Blender's automatic execution is switched off here.

    Args:
        up: the axis that points up in an OBJ, "Y" or "Z"; the other formats say it, or fix it.
    Raises:
        ArmError: Blender cannot import it.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    suffix, file = path.suffix.lower(), str(path)
    try:
        if suffix in {".glb", ".gltf"}:
            bpy.ops.import_scene.gltf(filepath=file)
        elif suffix == ".obj":
            bpy.ops.wm.obj_import(filepath=file, forward_axis="Y" if up == "Z" else "NEGATIVE_Z", up_axis=up)
        elif suffix == ".fbx":
            bpy.ops.import_scene.fbx(filepath=file)
        elif suffix in {".usd", ".usda", ".usdc", ".usdz"}:
            bpy.ops.wm.usd_import(filepath=file, import_cameras=False, import_lights=False, set_frame_range=False)
        else:
            raise ArmError(
                f"{path}: cannot import {suffix or 'a file without extension'}; give GLB, glTF, OBJ, FBX or USD"
            )
    except ArmError:
        raise
    except Exception as error:  # Blender's importers are scripts: a broken file ends in any of Python's errors.
        raise ArmError(f"cannot be imported: {reason(error)}") from error
    # Lights and cameras of a file are not the object's; the glTF importer keeps icospheres that display bones.
    for ob in list(bpy.data.objects):
        if ob.type in {"LIGHT", "CAMERA"} or (ob.name.startswith("Icosphere") and ob.data and not ob.data.materials):
            bpy.data.objects.remove(ob)
    return [o for o in bpy.data.objects if o.type == "MESH" and not o.hide_render]


def loose_points(objects: list[bpy.types.Object]) -> int:
    """How many points of the file belong to no face: vertices of meshes, and point clouds."""
    count = sum(len(o.data.points) for o in bpy.data.objects if o.type == "POINTCLOUD")
    for ob in objects:
        corners = np.empty(len(ob.data.loops), np.int32)
        ob.data.loops.foreach_get("vertex_index", corners)
        count += len(ob.data.vertices) - len(np.unique(corners))
    return count


def triangles(objects: list[bpy.types.Object]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
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
        raise ArmError("no triangles")
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


BEYOND_THE_BRDF: dict[str, float | tuple[float, float, float, float]] = {
    "Transmission Weight": 0.0,
    "Coat Weight": 0.0,
    "Sheen Weight": 0.0,
    "Emission Strength": 0.0,
    "IOR": 1.5,
    "Specular IOR Level": 0.5,
    "Specular Tint": (1.0, 1.0, 1.0, 1.0),
}
"""Sockets of the Principled BSDF that the paper's BRDF has no parameter for, with the values that it implies: an opaque
surface that reflects 4 % if it is no metal. An .mtl with Ks 0, as those of scans, says that it reflects nothing."""


def reduce_to_brdf(material: bpy.types.Material) -> None:
    """Take away what the paper's BRDF cannot say (ARM, supplement); it would end up in the albedo's truth."""
    node = principled(material)
    if node is None:
        return
    for name, value in BEYOND_THE_BRDF.items():
        set_constant(material, node.inputs[name], value)


def set_constant(
    material: bpy.types.Material, socket: bpy.types.NodeSocket, value: float | tuple[float, float, float, float]
) -> None:
    """One value for an input of a node of a material, whatever has driven it."""
    for link in list(socket.links):
        material.node_tree.links.remove(link)
    socket.default_value = value


def complete_materials(objects: list[bpy.types.Object]) -> None:
    """Give every object without a material the plain one that Blender draws, so that its albedo is known."""
    for ob in objects:
        if not ob.material_slots:
            ob.data.materials.append(None)
        for slot in ob.material_slots:
            if slot.material is None:
                slot.material = bpy.data.materials.new("plain")
                shader_tree(slot.material)


def materials(objects: list[bpy.types.Object]) -> list[bpy.types.Material]:
    """What the objects are made of, each once."""
    return list(dict.fromkeys(slot.material for ob in objects for slot in ob.material_slots if slot.material))


def has_finish_map(material: bpy.types.Material) -> bool:
    """Whether an image drives the roughness or the metallic of a material."""
    node = principled(material)
    if node is None:
        return False
    waiting, seen = [node.inputs["Roughness"], node.inputs["Metallic"]], set()
    while waiting:
        for link in waiting.pop().links:
            source = link.from_node
            if source.type == "TEX_IMAGE" and source.image is not None:
                return True
            if source.name not in seen:
                seen.add(source.name)
                waiting += list(source.inputs)
    return False


def vary_material(material: bpy.types.Material, rng: np.random.Generator) -> None:
    """A random finish for an object that has none of its own: a dielectric, or for one in four a real metal."""
    node = principled(material)
    if node is None:
        return
    metal = rng.random() < 0.25
    roughness = rng.uniform(0.08, 0.6) if metal else rng.uniform(0.15, 1.0)
    set_constant(material, node.inputs["Metallic"], float(metal))
    set_constant(material, node.inputs["Roughness"], float(roughness))
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
