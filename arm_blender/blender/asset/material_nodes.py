"""Material maps as images and as one material around a Principled BSDF."""

from typing import Literal

import bpy
import numpy as np
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from ...graphics.color import srgb_from_linear
from ...structures import MaterialMaps, Regions
from ...uv.normal_map import unit_from_normals
from ..compat import shader_tree
from .finish_nodes import BAKED, set_finishes
from .regions import NODE, STEPS, KnownRegion, KnownRegions, keep_regions

ColorSpace = Literal["sRGB", "Non-Color"]

UV_MAP = "UVMap"
"""Of the mesh, where the maps lie."""

NORMAL = "Normal"
"""The node of a normal map."""

_DIGITS = 2
"""Decimals of a predicted mean: what a slider shows is what it sets."""

_COLUMN = -640.0
_ROW = 320.0


def image_from_map(name: str, texels: Tensor, color_space: ColorSpace) -> bpy.types.Image:
    """An 8-bit image, packed into the .blend.

    Args:
        name: of the image; Blender numbers it where it is taken.
        texels: (3, T, T) or (1, T, T) in [0, 1], row 0 is v = 1; colours are linear Rec.709.
        color_space: "sRGB" encodes the linear colours; "Non-Color" stores the numbers as they are.
    """
    channels, height, width = texels.shape
    if channels not in (1, 3):
        raise ValueError(f"texels must be (3, T, T) or (1, T, T), got {tuple(texels.shape)}")
    texels = texels.detach().float().cpu().clamp(0.0, 1.0)
    if color_space == "sRGB":
        texels = srgb_from_linear(texels)
    pixels = np.ones((height, width, 4), dtype=np.float32)
    pixels[..., :3] = texels.flip(1).permute(1, 2, 0).numpy()  # Blender's pixels start at the bottom row.
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=False)
    image.colorspace_settings.name = color_space
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


def build_material(name: str, maps: MaterialMaps, normal: bpy.types.Image | None = None) -> bpy.types.Material:
    """One material that shows `maps` under any light.

    Base Color comes from the albedo, Roughness and Metallic from their map or, where that is a value, from the socket.
    The baked colour and the regions stay at hand as nodes that are connected to nothing, but to the table of finishes
    where any are set.

    Args:
        normal: a normal map that is an image already; it is taken where `maps` have none.
    """
    material = bpy.data.materials.new(name)
    material["arm_maps"] = True  # Tells it from a material of the user's.
    tree = shader_tree(material)
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (320.0, 0.0)
    surface = tree.nodes.new("ShaderNodeBsdfPrincipled")
    surface.location = (0.0, 0.0)
    tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])

    albedo = _add_texture(tree, image_from_map(f"{name} albedo", maps.albedo, "sRGB"), "Albedo", row=0)
    tree.links.new(albedo.outputs["Color"], surface.inputs["Base Color"])
    textures = [albedo]
    for row, (socket, texels) in enumerate((("Roughness", maps.roughness), ("Metallic", maps.metallic)), start=1):
        if isinstance(texels, float):
            surface.inputs[socket].default_value = texels
            continue
        image = image_from_map(f"{name} {socket.lower()}", texels, "Non-Color")
        texture = _add_texture(tree, image, socket, row)
        tree.links.new(texture.outputs["Color"], surface.inputs[socket])
        textures.append(texture)
    if maps.normal is not None:
        normal = image_from_map(f"{name} normal", unit_from_normals(maps.normal), "Non-Color")
    if normal is not None:
        textures.append(_add_normal_map(tree, surface, normal))
    baked = image_from_map(f"{name} baked", maps.baked, "sRGB")
    _add_texture(tree, baked, BAKED, row=3)
    if maps.regions is not None:
        textures.append(_add_regions(tree, name, maps.regions))
        keep_regions(material, _known(maps, maps.regions))
        set_finishes(material, maps.regions.finishes)
    _frame(tree, textures, "Relightable maps")
    tree.nodes.active = albedo  # The active image is what texture paint and solid view's texture mode show.
    return material


def _add_normal_map(tree: bpy.types.ShaderNodeTree, surface: bpy.types.Node, image: bpy.types.Image) -> bpy.types.Node:
    """The texture of a normal map, linked to `surface` through the node that takes it out of tangent space."""
    texture = _add_texture(tree, image, NORMAL, row=4)
    turned = tree.nodes.new("ShaderNodeNormalMap")
    turned.uv_map = UV_MAP
    turned.location = (_COLUMN / 2.0, texture.location[1])
    tree.links.new(texture.outputs["Color"], turned.inputs["Color"])
    tree.links.new(turned.outputs["Normal"], surface.inputs["Normal"])
    return texture


def _add_regions(tree: bpy.types.ShaderNodeTree, name: str, regions: Regions) -> bpy.types.Node:
    """The texture of the image of regions, at hand for the table of finishes and linked to nothing yet."""
    grey = (regions.index[None].float() + 0.5) / STEPS
    texture = _add_texture(tree, image_from_map(f"{name} regions", grey, "Non-Color"), NODE, row=5)
    texture.interpolation = "Closest"  # Between two regions lies no third.
    return texture


def _known(maps: MaterialMaps, regions: Regions) -> KnownRegions:
    """What the panel tells of the regions."""
    found = []
    for number, (area, swatch) in enumerate(zip(regions.area, regions.swatch, strict=True), start=1):
        inside = regions.index == number
        means = (round(_mean(texels, inside), _DIGITS) for texels in (maps.roughness, maps.metallic))
        found.append(KnownRegion(number, area, swatch, *means))
    return KnownRegions(tuple(found), regions.light)


def _mean(texels: Tensor | float, inside: Tensor) -> float:
    """Of a map (1, S, S), or of its one value, where `inside` (T, T) says so."""
    if isinstance(texels, float):
        return texels
    side = texels.shape[-1]
    weights = adaptive_avg_pool2d(inside[None].float(), side)
    return float((texels * weights).sum() / weights.sum().clamp(min=1e-6))


def _add_texture(tree: bpy.types.ShaderNodeTree, image: bpy.types.Image, label: str, row: int) -> bpy.types.Node:
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    node.label = label
    node.name = label
    node.width = 280.0
    node.location = (_COLUMN, _ROW * (1 - row))
    return node


def _frame(tree: bpy.types.ShaderNodeTree, nodes: list[bpy.types.Node], label: str) -> None:
    frame = tree.nodes.new("NodeFrame")
    frame.label = label
    for node in nodes:
        node.parent = frame
