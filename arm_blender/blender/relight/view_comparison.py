"""A view beside the asset under the light that was predicted for it, from the same camera, and the difference."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import bpy
import torch
from mathutils import Matrix

from ...export.light_file import write_comparison
from ...graphics.cameras import Camera
from ...graphics.color import srgb_from_linear
from ...light_check.comparison import comparison
from ...light_check.rerendering import psnr, resized
from ...views.image_io import read_image
from ..asset.asset_file import linked_asset
from ..asset.studio import add_view_camera, light_by_environment, temporary_scene
from ..compat import use_exr
from ..console import without_chatter
from .graphics_device import check_eevee
from .renders import RelightConfig, render_alone, render_scene


@dataclass(frozen=True)
class AskedView:
    """A view to compare with.

    Attributes:
        picture: (4, H, W) linear, straight alpha.
        camera: in the space of the object.
        gain: (3,) by which the picture's colours would have the exposure of the light; None where they have it.
    """

    picture: torch.Tensor
    camera: Camera
    gain: torch.Tensor | None = None


@without_chatter()
def compare_with_view(
    source: bpy.types.Object, view: AskedView, light: Path, sheet: Path, config: RelightConfig
) -> float | None:
    """Renders an object as a view shows it, wherever it stands in the open file, which stays as it is.

    Args:
        light: an environment map.
        sheet: the PNG: the view, the object, and how far they differ; its folder is made.
        config: engine, samples, and how many pixels the longer side has.
    Returns:
        dB between both, as of `light_check.rerendering.psnr`; None where they nowhere meet.
    Raises:
        ArmError: Eevee cannot run here, or something cannot be written.
    """
    if config.engine == "eevee":
        check_eevee()
    scale = config.resolution / max(view.camera.width, view.camera.height)
    camera = view.camera.resized(*(max(1, round(side * scale)) for side in (view.camera.width, view.camera.height)))
    with temporary_scene("Compare") as scene, tempfile.TemporaryDirectory(prefix="arm-compare-") as folder:
        linked_asset(scene, source)[0].matrix_world = Matrix.Identity(4)
        add_view_camera(scene, camera)
        light_by_environment(scene, light)
        render_alone(scene, config)
        use_exr(scene)
        scene.render.resolution_percentage = 100
        render_scene(scene, Path(folder) / "asset.exr")
        drawn = read_image(Path(folder) / "asset.exr")
    if view.gain is not None:
        drawn[:3] /= view.gain[:, None, None]
    picture = resized(view.picture, camera.height, camera.width)
    encoded = [torch.cat([srgb_from_linear(image[:3]), image[3:]]) for image in (picture, drawn)]
    sheet.parent.mkdir(parents=True, exist_ok=True)
    write_comparison(comparison(encoded[0][None], encoded[1][None]), sheet)
    return psnr(encoded[1], encoded[0])
