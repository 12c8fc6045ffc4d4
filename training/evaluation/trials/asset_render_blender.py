"""What an asset looks like under the truth's lights: rendered by Cycles, as the truth was."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix
from torch import Tensor

from arm_blender.blender.asset.scene import build_object
from arm_blender.blender.compat import shader_tree
from arm_blender.graphics.cameras import Camera
from arm_blender.structures import RelightableAsset

from ...rendering.render_blender import render_views
from ...rendering.scene_blender import import_object, reduce_to_brdf
from ..truth.protocol import Protocol
from ..truth.truth import Appearance, appearance, channels_first
from ..truth.truth_blender import light, prepare_render
from .baselines import ColoredMesh

COLORS = "arm_color"
"""Name of the attribute that holds a baseline's colours; a plain "color" Cycles takes for one of its own."""


def asset_lights(
    asset: RelightableAsset, cameras: Sequence[Camera], lights: Sequence[Path], protocol: Protocol
) -> list[Tensor]:
    """(V, 3, N, N) sRGB for each light, of an asset with its Principled BSDF."""
    return _lights(lambda: build_object(asset, {}, bpy.context.scene), cameras, lights, protocol)


def colored_lights(
    colored: ColoredMesh, cameras: Sequence[Camera], lights: Sequence[Path], protocol: Protocol
) -> list[Tensor]:
    """(V, 3, N, N) sRGB for each light, of a mesh whose base colour lies at its vertices."""
    return _lights(lambda: _build_colored(colored), cameras, lights, protocol)


def file_appearance(
    path: Path, motion: Tensor, cameras: Sequence[Camera], lights: Sequence[Path], protocol: Protocol
) -> Appearance:
    """What another system's mesh shows once it is moved: its own maps, and itself under one light, or two.

    Args:
        path: GLB, glTF or OBJ; an OBJ is taken to be Z up.
        motion: (4, 4) from the file's frame (Z up, as Blender imports it) to the truth's.
        lights: that it is lit by, and if there is a second that it is relit by.
    Raises:
        ArmError: the format is another.
    """
    import_object(path, "Z")
    for item in [o for o in bpy.data.objects if o.parent is None]:
        item.matrix_world = Matrix(motion.tolist()) @ item.matrix_world
    bpy.context.view_layer.update()
    for material in bpy.data.materials:
        reduce_to_brdf(material)
    prepare_render(protocol.resolution, protocol.asset_samples)
    light(lights[0])
    views = render_views(cameras)
    names = ("rgba", "albedo", "roughness", "metallic")
    found = appearance(tuple(cameras), {name: np.stack([view[name] for view in views]) for name in names})
    if len(lights) == 1:
        return found
    light(lights[1])
    return replace(found, relit=_lit(cameras))


def _lights(
    build: Callable[[], bpy.types.Object], cameras: Sequence[Camera], lights: Sequence[Path], protocol: Protocol
) -> list[Tensor]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build()
    prepare_render(protocol.resolution, protocol.asset_samples)
    found = []
    for hdri in lights:
        light(hdri)
        found.append(_lit(cameras))
    return found


def _build_colored(colored: ColoredMesh) -> bpy.types.Object:
    mesh = bpy.data.meshes.new("colored")
    mesh.from_pydata(colored.mesh.vertices.tolist(), [], colored.mesh.faces.tolist())
    attribute = mesh.color_attributes.new(COLORS, "FLOAT_COLOR", "POINT")
    rgba = np.concatenate([colored.colors.numpy(), np.ones((len(colored.colors), 1), np.float32)], axis=1)
    attribute.data.foreach_set("color", rgba.astype(np.float32).ravel())
    mesh.shade_smooth()
    material = bpy.data.materials.new("colored")
    tree = shader_tree(material)
    surface = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    source = tree.nodes.new("ShaderNodeVertexColor")
    source.layer_name = COLORS
    tree.links.new(source.outputs["Color"], surface.inputs["Base Color"])
    surface.inputs["Roughness"].default_value = colored.roughness
    surface.inputs["Metallic"].default_value = colored.metallic
    mesh.materials.append(material)
    placed = bpy.data.objects.new("colored", mesh)
    bpy.context.scene.collection.objects.link(placed)
    return placed


def _lit(cameras: Sequence[Camera]) -> Tensor:
    """(V, 3, N, N) sRGB of the open scene."""
    return channels_first(np.stack([view["rgba"][..., :3] for view in render_views(cameras)]))
