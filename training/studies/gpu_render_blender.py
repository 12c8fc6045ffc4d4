"""Whether Cycles renders on a graphics device what it renders on the processor."""

import time
from typing import Any

import bpy
import torch

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.color import linear_from_srgb

from ..evaluation.scores.image_scores import psnr_inside
from ..rendering.passes_blender import RenderConfig, configure_cycles, graphics_devices
from ..rendering.render_blender import render_views


def rendered_alike(resolution: int, samples: int) -> dict[str, Any]:
    """A grey ball rendered on both.

    Args:
        resolution: pixels a side.
        samples: of Cycles, a pixel.
    Returns:
        "skipped": why nothing was rendered; else "kind" of device, its "seconds", and "psnr" in dB.
    """
    if graphics_devices() is None:
        return {"skipped": "Cycles finds no graphics device here"}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    kind = graphics_devices()  # The settings forget what was switched on.
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8)
    bpy.ops.object.light_add(type="SUN", rotation=(0.5, 0.3, 0.0))
    camera = orbit_camera(30.0, 20.0, 4.0, 30.0, resolution, resolution)
    pictures, seconds = [], 0.0
    for gpu in (False, True):
        configure_cycles(RenderConfig(resolution=resolution, samples=samples, denoise=False, gpu=gpu))
        started = time.perf_counter()
        (view,) = render_views((camera,))
        seconds = time.perf_counter() - started
        pictures.append(torch.from_numpy(view["rgba"]).permute(2, 0, 1) / 255.0)
    inside = (pictures[0][3] > 0.99) & (pictures[1][3] > 0.99)
    colors = [linear_from_srgb(picture[:3]) for picture in pictures]
    return {"kind": kind, "seconds": seconds, "psnr": psnr_inside(colors[1], colors[0], inside)}
