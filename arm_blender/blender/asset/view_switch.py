"""What a result's material shows: itself under the light, or one of its maps as it is."""

import bpy
from bpy.props import EnumProperty

from ..compat import shader_tree

SHADED = "shaded"

MAP_NODES = {
    "albedo": "Albedo",
    "baked": "Baked color: lighting of the views included",
    "roughness": "Roughness",
    "metallic": "Metallic",
}
"""The name of each map's texture node, as `build_material` names it; a constant map has none."""

_EMISSION = "ARM map view"
_SHADED_FROM = "arm_shaded_from"
"""Custom property of a material that shows a map: node and socket that its output belongs to."""


def show(material: bpy.types.Material, view: str) -> None:
    """Have a material show `view`: "shaded", or a key of `MAP_NODES` as light of its own.

    Back at "shaded" the material is what it was before, whatever the user had linked to its output.

    Raises:
        ValueError: there is no such view.
    """
    if view != SHADED and view not in MAP_NODES:
        raise ValueError(f"view must be {SHADED} or one of {', '.join(MAP_NODES)}, got {view!r}")
    tree = shader_tree(material)
    output = tree.get_output_node("ALL")
    if output is None:
        return
    surface = output.inputs["Surface"]
    if view == SHADED:
        _restore(material, tree, surface)
        return
    if tree.nodes.get(_EMISSION) is None:
        material[_SHADED_FROM] = (
            [surface.links[0].from_node.name, surface.links[0].from_socket.identifier]
            if surface.is_linked
            else ["", ""]
        )
        added = tree.nodes.new("ShaderNodeEmission")
        added.name = added.label = _EMISSION
        added.location = (output.location.x - 200.0, output.location.y - 160.0)
    emission = tree.nodes[_EMISSION]
    tree.links.new(emission.outputs["Emission"], surface)
    color = emission.inputs["Color"]
    for link in list(color.links):
        tree.links.remove(link)
    texture = tree.nodes.get(MAP_NODES[view])
    if texture is not None:
        tree.links.new(texture.outputs["Color"], color)
    else:
        value = _constant(tree, view)
        color.default_value = (value, value, value, 1.0)


def _restore(material: bpy.types.Material, tree: bpy.types.ShaderNodeTree, surface: bpy.types.NodeSocket) -> None:
    emission = tree.nodes.get(_EMISSION)
    if emission is None:
        return
    tree.nodes.remove(emission)
    name, identifier = material.pop(_SHADED_FROM, ("", ""))
    source = tree.nodes.get(name)
    if source is not None:
        tree.links.new(next(s for s in source.outputs if s.identifier == identifier), surface)


def _constant(tree: bpy.types.ShaderNodeTree, view: str) -> float:
    """The value of a map that has no texture; 0 where the user has taken the Principled BSDF away."""
    surface = next((node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"), None)
    return 0.0 if surface is None else surface.inputs[view.capitalize()].default_value


def _changed(material: bpy.types.Material, context: bpy.types.Context) -> None:
    show(material, material.arm_view)


def register() -> None:
    bpy.types.Material.arm_view = EnumProperty(
        name="Show",
        description="What the material shows; only Shaded is for rendering",
        items=(
            (SHADED, "Shaded", "The material under the light of the scene"),
            ("albedo", "Albedo", "The color of the surface, without any lighting"),
            ("baked", "Baked", "The color with the lighting of the views in it"),
            ("roughness", "Roughness", "White is rough"),
            ("metallic", "Metallic", "White is metal"),
        ),
        default=SHADED,
        update=_changed,
    )


def unregister() -> None:
    del bpy.types.Material.arm_view
