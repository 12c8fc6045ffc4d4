"""An object of the open file as an asset again: what `build_object` made, with whatever the user did to it since."""

from typing import Any

import bpy
import numpy as np
import torch
from numpy.typing import DTypeLike, NDArray
from torch import Tensor

from ...errors import ArmError, EmptyMeshError
from ...graphics.color import linear_from_srgb
from ...structures import VALUE_SIDE, MaterialMaps, Regions, RelightableAsset, UvMesh
from .finish_nodes import finish_node, finishes, is_value
from .regions import STEPS, known_regions, regions_image


def asset_from_object(source: bpy.types.Object) -> RelightableAsset:
    """The mesh with its modifiers and its place in the world, and the maps that reach its Principled BSDF.

    The maps are as predicted where regions are set to a finish; `maps.regions` has it.

    Raises:
        EmptyMeshError: there is no face, or no UV map.
        ArmError: the material is not of the kind that we make; the line says what is missing.
    """
    return RelightableAsset(bpy.path.clean_name(source.name), _mesh(source), _maps(source))


def _mesh(source: bpy.types.Object) -> UvMesh:
    evaluated = source.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    try:
        mesh.calc_loop_triangles()
        if not len(mesh.loop_triangles):
            raise EmptyMeshError(f"{source.name}: has no faces; nothing to export")
        if mesh.uv_layers.active is None:
            raise EmptyMeshError(f"{source.name}: has no UV map; unwrap it first")
        vertices = _read(mesh.vertices, "co", 3, np.float32)
        faces = _read(mesh.loop_triangles, "vertices", 3, np.int32)
        corners = _read(mesh.loop_triangles, "loops", 3, np.int32)
        uvs = _read(mesh.uv_layers.active.uv, "vector", 2, np.float32)
    finally:
        evaluated.to_mesh_clear()
    matrix = np.array(source.matrix_world, dtype=np.float64)
    vertices = (vertices @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
    if np.linalg.det(matrix[:3, :3]) < 0.0:  # Mirrored: what went counter-clockwise goes clockwise now.
        faces, corners = faces[:, ::-1], corners[:, ::-1]
    distinct, index = np.unique(uvs, axis=0, return_inverse=True)
    face_uvs = index.reshape(-1)[corners]
    return UvMesh(
        torch.from_numpy(vertices),
        torch.from_numpy(faces.astype(np.int64)),
        torch.from_numpy(distinct),
        torch.from_numpy(face_uvs.astype(np.int64)),
        charts=1,
    )


def _read(collection: bpy.types.bpy_prop_collection, name: str, width: int, kind: DTypeLike) -> NDArray[Any]:
    """(N, width) of a property of all elements."""
    flat = np.empty(len(collection) * width, dtype=kind)
    collection.foreach_get(name, flat)
    return flat.reshape(-1, width)


def _maps(source: bpy.types.Object) -> MaterialMaps:
    tree = source.active_material.node_tree if source.active_material is not None else None
    nodes = list(tree.nodes) if tree is not None else []
    surface = next((node for node in nodes if node.type == "BSDF_PRINCIPLED"), None)
    if surface is None:
        raise ArmError(f"{source.name}: has no material with a Principled BSDF; generate it, or give it one")
    albedo = _map(surface, "Base Color", 3)
    # The colour with the lighting of the views has a node of its own, whatever it is linked to.
    textures = [node for node in nodes if node.type == "TEX_IMAGE" and node.image is not None]
    baked = next((node for node in textures if node.name.startswith("Baked")), None)
    return MaterialMaps(
        albedo,
        albedo if baked is None else _texels(baked.image, 3),
        _map_or_value(surface, "Roughness"),
        _map_or_value(surface, "Metallic"),
        2.0 * _map(surface, "Normal", 3) - 1.0 if surface.inputs["Normal"].is_linked else None,
        _regions(source.active_material),
    )


def _map_or_value(surface: bpy.types.Node, socket: str) -> Tensor | float:
    """(1, T, T) of the image that reaches an input, or its value."""
    entry = surface.inputs[socket]
    if entry.is_linked and entry.links[0].from_node == finish_node(surface.id_data):
        entry = entry.links[0].from_node.inputs[socket]
        if is_value(entry):
            return float(entry.default_value)
    return _map(entry.node, socket, 1) if entry.is_linked else float(entry.default_value)


def _map(surface: bpy.types.Node, socket: str, channels: int) -> Tensor:
    """(C, T, T) of the image that reaches an input, or a small one of its colour; row 0 is v = 1."""
    entry = surface.inputs[socket]
    if not entry.is_linked:
        color = torch.tensor(list(entry.default_value[:channels]))
        return color.view(-1, 1, 1).expand(-1, VALUE_SIDE, VALUE_SIDE).contiguous()
    node = entry.links[0].from_node
    if node == finish_node(surface.id_data):  # The prediction lies behind the table.
        return _map(node, socket, channels)
    if node.type == "NORMAL_MAP" and node.inputs["Color"].is_linked:
        node = node.inputs["Color"].links[0].from_node
    if node.type != "TEX_IMAGE" or node.image is None or 0 in node.image.size:
        raise ArmError(f"{surface.id_data.name}: {socket} is no image texture; bake it to one, or unlink it")
    return _texels(node.image, channels)


def _regions(material: bpy.types.Material) -> Regions | None:
    """The regions with what is set of them; None of a material from before there were any."""
    image, known = regions_image(material), known_regions(material)
    if image is None or not known.regions:
        return None
    index = (_texels(image, 1)[0] * STEPS).to(torch.uint8).clamp(max=len(known.regions))
    area, swatch = zip(*((region.area, region.swatch) for region in known.regions), strict=True)
    return Regions(index, area, swatch, known.light, finishes(material))


def _texels(image: bpy.types.Image, channels: int) -> Tensor:
    """(C, T, T) of an image as the program holds it: colours linear, data as it is."""
    width, height = image.size
    if width != height:
        raise ArmError(f"{image.name}: {width}x{height} pixels; maps have to be square")
    flat = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(flat)
    stored = torch.from_numpy(flat.reshape(height, width, 4)[::-1, :, :channels].copy()).permute(2, 0, 1).contiguous()
    return linear_from_srgb(stored) if image.colorspace_settings.name == "sRGB" and not image.is_float else stored
