"""The finishes that regions of a material are set to, as a table in its node tree: between its maps and its surface.

The table is a node group, "ARM Finish": colour ramps of constant steps, one a region, driven by the image of the
regions. Nothing is kept elsewhere: what renders is what is read back. The maps stay as they were predicted, and where
nothing is set there is no group. It says of a texel what `uv.finish.finished` says of a map.
"""

from collections.abc import Mapping

import bpy

from ...knobs.finishes import Finish
from ..compat import shader_tree
from .regions import NODE, STEPS, known_regions, make_steps, regions_image

GROUP = "ARM Finish"
"""The name of the node and of its group."""

BAKED = "Baked color: lighting of the views included"
"""The node of the baked colour, which metals that have no name are made of."""

CHANNELS = {"Base Color": "NodeSocketColor", "Roughness": "NodeSocketFloat", "Metallic": "NodeSocketFloat"}
"""Inputs of the Principled BSDF that the table may feed, and the kind of socket of each."""

_FINISH, _METAL = "Finish", "Base color of metal"
"""The ramps. Red and green of the first are roughness and metallic, its alpha is 1 where a region is as predicted and 0
where it is set. The second is F0; its alpha is 0 where that is known."""

_NOTHING = (0.0, 0.0, 0.0, 1.0)

_DIGITS = 6
"""Decimals that ramps, which hold 32-bit floats, tell apart."""


def can_be_set(material: bpy.types.Material) -> bool:
    """It has an image of regions, and a Principled BSDF for the table to feed."""
    return regions_image(material) is not None and _surface(shader_tree(material)) is not None


def finishes(material: bpy.types.Material) -> dict[int, Finish]:
    """The finishes that regions are set to, by their numbers; the others are as predicted."""
    node = finish_node(shader_tree(material))
    if node is None:
        return {}
    found = ((number, _read(node.node_tree, number)) for number in range(1, STEPS))
    return {number: finish for number, finish in found if finish is not None}


def set_finish(material: bpy.types.Material, number: int, finish: Finish | None) -> None:
    """Set one region of a material that `can_be_set`, and leave the others; None is as predicted."""
    others = {other: kept for other, kept in finishes(material).items() if other != number}
    set_finishes(material, others if finish is None else others | {number: finish})


def set_finishes(material: bpy.types.Material, wanted: Mapping[int, Finish]) -> None:
    """Set regions of a material that `can_be_set`, by their numbers, and all others as predicted."""
    tree = shader_tree(material)
    node, surface = finish_node(tree), _surface(tree)
    if surface is None or (node is None and not wanted):
        return
    if node is None:
        node = _add(material, tree)
    elif node.node_tree.users > 1:  # Of a copy of the material, whose regions are its own.
        node.node_tree = node.node_tree.copy()
    for number in range(1, STEPS):
        _write(node.node_tree, number, wanted.get(number))
    for channel in CHANNELS:
        used = any(finish.metallic > 0.0 for finish in wanted.values()) if channel == "Base Color" else bool(wanted)
        (_link if used else _unlink)(tree, node, surface.inputs[channel])
    if not wanted:
        group = node.node_tree
        tree.nodes.remove(node)
        if not group.users:
            bpy.data.node_groups.remove(group)


def finish_node(tree: bpy.types.ShaderNodeTree) -> bpy.types.Node | None:
    """The node of the table, where there is one."""
    node = tree.nodes.get(GROUP)
    return node if node is not None and node.type == "GROUP" and node.node_tree is not None else None


def _surface(tree: bpy.types.ShaderNodeTree) -> bpy.types.Node | None:
    return next((node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"), None)


def _add(material: bpy.types.Material, tree: bpy.types.ShaderNodeTree) -> bpy.types.Node:
    """An empty table, driven by the image of regions; the surface is not linked to it yet."""
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = _new_group()
    node.name = node.label = GROUP
    node.width = 160.0
    node.location = (-240.0, -60.0)
    node.inputs["Light"].default_value = (*known_regions(material).light, 1.0)
    for name, source in (("Region", NODE), ("Baked", BAKED)):
        if source in tree.nodes:
            tree.links.new(tree.nodes[source].outputs["Color"], node.inputs[name])
    return node


def _new_group() -> bpy.types.ShaderNodeTree:
    group = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    for name, kind in {"Region": "NodeSocketFloat", "Baked": "NodeSocketColor", "Light": "NodeSocketColor"}.items():
        group.interface.new_socket(name, in_out="INPUT", socket_type=kind)
    for channel, kind in CHANNELS.items():
        for way in ("INPUT", "OUTPUT"):
            group.interface.new_socket(channel, in_out=way, socket_type=kind)
    given, taken = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    given.location, taken.location = (-700.0, 0.0), (560.0, 0.0)
    ramps = [_new_ramp(group, given, name, y) for name, y in ((_FINISH, 0.0), (_METAL, -280.0))]
    parts = group.nodes.new("ShaderNodeSeparateColor")
    parts.location = (-180.0, 0.0)
    group.links.new(ramps[0].outputs["Color"], parts.inputs[0])
    # The prediction comes first wherever the two meet: exporters that know no such node take the first image they find.
    for channel, chosen, y in (("Roughness", parts.outputs[0], 140.0), ("Metallic", parts.outputs[1], -60.0)):
        sum_of = _added(group, "ShaderNodeMath", given.outputs[channel], ramps[0].outputs["Alpha"], chosen, (260.0, y))
        group.links.new(sum_of, taken.inputs[channel])
    remade, metals = _remade(group, given), ramps[1].outputs
    metal = _added(group, "ShaderNodeVectorMath", remade, metals["Alpha"], metals["Color"], (20.0, -300.0))
    rest, share = group.nodes.new("ShaderNodeMath"), group.nodes.new("ShaderNodeVectorMath")
    rest.operation, share.operation = "SUBTRACT", "SCALE"
    rest.inputs[0].default_value = 1.0
    rest.location, share.location = (20.0, -120.0), (200.0, -420.0)
    group.links.new(parts.outputs[1], rest.inputs[1])
    group.links.new(metal, share.inputs[0])
    group.links.new(parts.outputs[1], share.inputs["Scale"])
    base = _added(
        group, "ShaderNodeVectorMath", given.outputs["Base Color"], rest.outputs[0], share.outputs[0], (360.0, -240.0)
    )
    group.links.new(base, taken.inputs["Base Color"])
    return group


def _new_ramp(group: bpy.types.ShaderNodeTree, given: bpy.types.Node, name: str, y: float) -> bpy.types.Node:
    steps = group.nodes.new("ShaderNodeValToRGB")
    steps.name = steps.label = name
    steps.location = (-460.0, y)
    make_steps(steps.color_ramp)
    group.links.new(given.outputs["Region"], steps.inputs[0])
    return steps


def _remade(group: bpy.types.ShaderNodeTree, given: bpy.types.Node) -> bpy.types.NodeSocket:
    """The views' colour over their light, at most 1."""
    ratio, most = group.nodes.new("ShaderNodeVectorMath"), group.nodes.new("ShaderNodeVectorMath")
    ratio.operation, most.operation = "DIVIDE", "MINIMUM"
    ratio.location, most.location = (-460.0, -560.0), (-180.0, -560.0)
    most.inputs[1].default_value = (1.0, 1.0, 1.0)
    group.links.new(given.outputs["Baked"], ratio.inputs[0])
    group.links.new(given.outputs["Light"], ratio.inputs[1])
    group.links.new(ratio.outputs["Vector"], most.inputs[0])
    return most.outputs["Vector"]


def _added(
    group: bpy.types.ShaderNodeTree,
    kind: str,
    first: bpy.types.NodeSocket,
    share: bpy.types.NodeSocket,
    second: bpy.types.NodeSocket,
    place: tuple[float, float],
) -> bpy.types.NodeSocket:
    """The output of a node that makes first * share + second."""
    node = group.nodes.new(kind)
    node.operation, node.location = "MULTIPLY_ADD", place
    for source, entry in zip((first, share, second), node.inputs, strict=False):
        group.links.new(source, entry)
    return node.outputs[0]


def _read(group: bpy.types.ShaderNodeTree, number: int) -> Finish | None:
    finish, metal = (
        [round(value, _DIGITS) for value in group.nodes[name].color_ramp.elements[number].color]
        for name in (_FINISH, _METAL)
    )
    if finish[3] > 0.5:
        return None
    return Finish(finish[0], finish[1], (metal[0], metal[1], metal[2]) if metal[3] < 0.5 else None)


def _write(group: bpy.types.ShaderNodeTree, number: int, finish: Finish | None) -> None:
    wanted = _NOTHING if finish is None else (finish.roughness, finish.metallic, 0.0, 0.0)
    metal = _NOTHING if finish is None or finish.f0 is None else (*finish.f0, 0.0)
    for name, color in ((_FINISH, wanted), (_METAL, metal)):
        group.nodes[name].color_ramp.elements[number].color = color


def _link(tree: bpy.types.ShaderNodeTree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> None:
    """Put the table between an input of the surface and what feeds it; nothing where it is there."""
    channel = socket.name
    if socket.is_linked and socket.links[0].from_node == node:
        return
    if socket.is_linked:
        tree.links.new(socket.links[0].from_socket, node.inputs[channel])
    else:
        node.inputs[channel].default_value = socket.default_value
        if CHANNELS[channel] == "NodeSocketFloat":
            tree.links.new(_add_value(tree, channel, socket.default_value), node.inputs[channel])
    tree.links.new(node.outputs[channel], socket)


def _unlink(tree: bpy.types.ShaderNodeTree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> None:
    """Take the table from between them again; nothing where it is not there."""
    if not socket.is_linked or socket.links[0].from_node != node:
        return
    given = node.inputs[socket.name]
    if is_value(given):
        held = given.links[0].from_node
        image = held.image
        tree.nodes.remove(held)
        if not image.users:
            bpy.data.images.remove(image)
    if given.is_linked:
        tree.links.new(given.links[0].from_socket, socket)
        tree.links.remove(given.links[0])
    else:
        socket.default_value = given.default_value
        tree.links.remove(socket.links[0])


def is_value(entry: bpy.types.NodeSocket) -> bool:
    """Whether what reaches an input of the table is one value, that of the input, in the place of a map."""
    return entry.is_linked and entry.links[0].from_node.name == _value_name(entry.name)


def _add_value(tree: bpy.types.ShaderNodeTree, channel: str, value: float) -> bpy.types.NodeSocket:
    """An image of one texel and that value: without any, exporters that know no such node take that of the regions."""
    image = bpy.data.images.new(_value_name(channel), 1, 1, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set([value, value, value, 1.0])
    image.update()
    image.pack()
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    node.name = node.label = _value_name(channel)
    node.hide = True
    node.location = (-520.0, {"Roughness": -120.0, "Metallic": -170.0}[channel])
    return node.outputs["Color"]


def _value_name(channel: str) -> str:
    return f"{channel}, one value"
