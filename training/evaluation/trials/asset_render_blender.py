"""What an asset looks like under the truth's lights: rendered by Cycles, as the truth was."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import torch
from mathutils import Matrix
from numpy.typing import NDArray
from torch import Tensor

from arm_blender.blender.asset.scene import build_object
from arm_blender.blender.compat import shader_tree
from arm_blender.graphics.cameras import Camera
from arm_blender.structures import RelightableAsset

from ...rendering.scene_blender import import_object, reduce_to_brdf
from ..truth.protocol import Protocol
from ..truth.truth import Appearance
from ..truth.truth_blender import light, prepare_render, render_pictures
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
    pictures = render_pictures(cameras)
    rgba = _channels_first([picture["rgba"] for picture in pictures])
    found = Appearance(
        tuple(cameras),
        rgba[:, 3:],
        _channels_first([picture["albedo"] for picture in pictures]),
        _channels_first([picture["roughness"][..., None] for picture in pictures]),
        _channels_first([picture["metallic"][..., None] for picture in pictures]),
        lit=rgba[:, :3],
    )
    if len(lights) == 1:
        return found
    light(lights[1])
    relit = _channels_first([picture["rgba"][..., :3] for picture in render_pictures(cameras)])
    return replace(found, relit=relit)


def _lights(
    build: Callable[[], bpy.types.Object], cameras: Sequence[Camera], lights: Sequence[Path], protocol: Protocol
) -> list[Tensor]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    build()
    prepare_render(protocol.resolution, protocol.asset_samples)
    found = []
    for hdri in lights:
        light(hdri)
        found.append(_channels_first([picture["rgba"][..., :3] for picture in render_pictures(cameras)]))
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


def _channels_first(pictures: Sequence[NDArray[np.uint8]]) -> Tensor:
    """(V, C, N, N) in [0, 1] of V (N, N, C) uint8."""
    return torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2).float() / 255.0
