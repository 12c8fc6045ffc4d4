"""One view by one pass of Cycles: colour, alpha, depth, world normal, albedo, roughness and metallic."""

import logging
import os
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO as oiio
import torch
from numpy.typing import NDArray

from arm_blender.blender.asset.studio import add_view_camera, aim_view_camera
from arm_blender.blender.compat import use_cycles, use_exr
from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.graphics.color import bytes_from_unit, srgb_from_linear

from .shards import Arrays

logger = logging.getLogger(__name__)

SCRATCH = "/dev/shm" if os.path.isdir("/dev/shm") else None
"""Where Blender leaves its EXRs for a moment: in memory where the system has such a place."""


@dataclass(frozen=True)
class RenderConfig:
    """How one view is rendered."""

    resolution: int = 192
    """Pixels a side."""
    samples: int = 16
    """Cycles samples a pixel. Fewer leave noise that the texture inherits."""
    denoise: bool = True
    """OpenImageDenoise where this Blender has it."""
    gpu: bool = True
    """Render on the machine's graphics devices, where Cycles finds any."""


def configure_cycles(config: RenderConfig) -> None:
    """Set up the scene for one-pass rendering into a multilayer EXR, with a camera."""
    scene = bpy.context.scene
    render = scene.render
    use_cycles(scene, config.samples, config.denoise)
    if config.gpu and (kind := graphics_devices()):
        scene.cycles.device = "GPU"
        logger.debug("rendering by %s", kind)
    # Processes side by side share the machine's cores.
    if threads := int(os.environ.get("OMP_NUM_THREADS", "0").partition(",")[0]):
        render.threads_mode, render.threads = "FIXED", threads
    render.film_transparent = True
    render.use_persistent_data = True
    render.use_compositing = render.use_sequencer = False
    render.dither_intensity = 0.0
    scene.view_settings.view_transform = "Standard"
    cycles = scene.cycles
    cycles.max_bounces, cycles.use_auto_tile = 4, False
    cycles.pixel_filter_type = "BOX"
    if cycles.use_denoising:
        cycles.denoising_prefilter, cycles.denoising_quality = "FAST", "FAST"
    use_exr(scene, layers=True)
    add_view_camera(scene, orbit_camera(0.0, 0.0, 1.0, 30.0, config.resolution, config.resolution))


def graphics_devices() -> str | None:
    """Switch on all graphics devices of the fastest kind that Cycles finds here; the kind's name, None without any."""
    preferences = bpy.context.preferences.addons["cycles"].preferences
    for kind in ("OPTIX", "CUDA", "HIP", "METAL", "ONEAPI"):
        try:
            preferences.compute_device_type = kind
        except TypeError:  # This build of Blender does not know it.
            continue
        preferences.refresh_devices()
        if any(device.type == kind for device in preferences.devices):
            for device in preferences.devices:
                device.use = device.type == kind
            return kind
    return None


def read_layers(path: Path) -> dict[str, NDArray[np.float32]]:
    """Channels of a multilayer EXR by `Layer.Channel`; Blender 5.0 and later write one part a pass."""
    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise ArmError(f"{path}: cannot be read; was the disk full?")
    layers, part = {}, 0
    while file.seek_subimage(part, 0):
        spec = file.spec()
        pixels = file.read_image(part, 0, 0, spec.nchannels, "float")
        if pixels is None:
            raise ArmError(f"{path}: cannot be read ({file.geterror()}); was the disk full?")
        for index, channel in enumerate(spec.channelnames):
            layers[".".join(channel.split(".")[-2:])] = pixels[..., index]
        part += 1
    file.close()
    return layers


def channels(layers: dict[str, NDArray[np.float32]], name: str, suffixes: str) -> NDArray[np.float32]:
    """(H, W, C) of one pass, whichever of the equivalent suffixes this version of Blender wrote."""
    planes = [layers[f"{name}.{s}"] for s in suffixes if f"{name}.{s}" in layers]
    return np.stack(planes, axis=-1)


def byte_image(values: NDArray[np.float32], srgb: bool) -> NDArray[np.uint8]:
    """uint8 of [0, 1]; linear colours encoded to sRGB on the way where `srgb`."""
    image = torch.from_numpy(np.ascontiguousarray(values))
    return bytes_from_unit(srgb_from_linear(image) if srgb else image).numpy()


def render_view(camera: Camera, scratch: Path) -> Arrays:
    """One view: rgba (H, W, 4) uint8 sRGB straight, albedo uint8 sRGB, roughness, metallic uint8, depth, normal."""
    aim_view_camera(bpy.context.scene, camera)
    bpy.context.scene.render.filepath = str(scratch / "view.exr")
    bpy.ops.render.render(write_still=True)
    layers = read_layers(scratch / "view.exr")
    premultiplied, alpha = channels(layers, "Combined", "RGB"), layers["Combined.A"].clip(0.0, 1.0)
    coverage = np.maximum(alpha, 1e-4)[..., None]
    depth = channels(layers, "Depth", "ZV")[..., 0]
    return {
        "rgba": np.dstack([byte_image(premultiplied / coverage, srgb=True), byte_image(alpha, srgb=False)]),
        "albedo": byte_image(channels(layers, "arm_albedo", "RGB") / coverage, srgb=True),
        # A scalar AOV is named X or V by version; both hold the premultiplied value.
        "roughness": byte_image(channels(layers, "arm_roughness", "XV")[..., 0] / coverage[..., 0], srgb=False),
        "metallic": byte_image(channels(layers, "arm_metallic", "XV")[..., 0] / coverage[..., 0], srgb=False),
        "depth": np.where(depth > 1e4, np.inf, depth).astype(np.float16),
        "normal": (np.clip(channels(layers, "Normal", "XYZ"), -1.0, 1.0) * 127.0).astype(np.int8),
    }
