"""What a result's material shows: itself under the light, or one of its maps as it is."""

import bpy
from bpy.props import EnumProperty

from ..compat import shader_tree
from .finish_nodes import BAKED, finish_node
from .regions import NODE, known_regions, make_steps, regions_image

SHADED = "shaded"
REGIONS = "regions"

MAP_NODES = {
    "albedo": "Albedo",
    "baked": BAKED,
    "roughness": "Roughness",
    "metallic": "Metallic",
}
"""The name of each map's texture node, as `build_material` names it; a constant map has none."""

_SOCKETS = {"albedo": "Base Color", "roughness": "Roughness", "metallic": "Metallic"}
"""The input of the Principled BSDF that shows a map; what regions are set to comes between."""

_CHOSEN = (0.85, 0.12, 0.0)
"""The colour of the chosen region among the swatches, linear: the orange of what Blender has selected."""

_EMISSION = "ARM map view"
_SWATCHES = "ARM region swatches"
_SHADED_FROM = "arm_shaded_from"
"""Custom property of a material that shows a map: node and socket that its output belongs to."""


def show(material: bpy.types.Material, view: str) -> None:
    """Have a material show `view`: "shaded", or a key of `MAP_NODES` or its "regions" as light of its own.

    What regions are set to shows in its maps.

    Back at "shaded" the material is what it was before, whatever the user had linked to its output.

    Raises:
        ValueError: there is no such view.
    """
    if view not in (SHADED, REGIONS, *MAP_NODES):
        raise ValueError(f"view must be {SHADED}, {REGIONS} or one of {', '.join(MAP_NODES)}, got {view!r}")
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
    _remove_swatches(tree)
    source = _source(material, tree, view)
    if source is not None:
        tree.links.new(source, color)
    else:
        value = _constant(tree, view)
        color.default_value = (value, value, value, 1.0)


def _source(material: bpy.types.Material, tree: bpy.types.ShaderNodeTree, view: str) -> bpy.types.NodeSocket | None:
    """What a view shows; None is a constant."""
    if view == REGIONS:
        return _add_swatches(material, tree)
    finish, channel = finish_node(tree), _SOCKETS.get(view)
    if finish is not None and channel is not None and finish.outputs[channel].is_linked:
        return finish.outputs[channel]
    texture = tree.nodes.get(MAP_NODES[view])
    return None if texture is None else texture.outputs["Color"]


def _add_swatches(material: bpy.types.Material, tree: bpy.types.ShaderNodeTree) -> bpy.types.NodeSocket | None:
    """Steps that paint each region in the colour of its swatch, and the chosen one orange."""
    if regions_image(material) is None:
        return None
    steps = tree.nodes.new("ShaderNodeValToRGB")
    steps.name = steps.label = _SWATCHES
    steps.location = (tree.nodes[_EMISSION].location.x - 280.0, tree.nodes[_EMISSION].location.y)
    elements = make_steps(steps.color_ramp)
    for region in known_regions(material).regions:
        color = _CHOSEN if region.number == getattr(material, "arm_region", 0) else region.swatch
        elements[region.number].color = (*color, 1.0)
    tree.links.new(tree.nodes[NODE].outputs["Color"], steps.inputs[0])
    return steps.outputs["Color"]


def _remove_swatches(tree: bpy.types.ShaderNodeTree) -> None:
    steps = tree.nodes.get(_SWATCHES)
    if steps is not None:
        tree.nodes.remove(steps)


def _restore(material: bpy.types.Material, tree: bpy.types.ShaderNodeTree, surface: bpy.types.NodeSocket) -> None:
    emission = tree.nodes.get(_EMISSION)
    if emission is None:
        return
    _remove_swatches(tree)
    tree.nodes.remove(emission)
    name, identifier = material.pop(_SHADED_FROM, ("", ""))
    source = tree.nodes.get(name)
    if source is not None:
        tree.links.new(next(s for s in source.outputs if s.identifier == identifier), surface)


def _constant(tree: bpy.types.ShaderNodeTree, view: str) -> float:
    """The value of a map that has no texture; 0 where the user has taken the Principled BSDF away."""
    surface = next((node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"), None)
    return 0.0 if surface is None or view not in _SOCKETS else surface.inputs[_SOCKETS[view]].default_value


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
            (REGIONS, "Regions", "The parts of one finish in the colors of their swatches, the chosen one orange"),
        ),
        default=SHADED,
        update=_changed,
    )


def unregister() -> None:
    del bpy.types.Material.arm_view
