"""A result as an asset of Blender's asset browser, with a picture of itself that needs no graphics device."""

import bpy
import numpy as np
import torch
from numpy.typing import NDArray

from ...graphics.color import srgb_from_linear
from ...graphics.raster.rasterize import interpolate, rasterize
from ...graphics.textures import sample_texture
from ...structures import RelightableAsset
from ...views.rigs import zero123plus_rig

SIDE = 256
"""Pixels of the picture; Blender shows it at most at this size."""


def mark_as_asset(made: bpy.types.Object, asset: RelightableAsset) -> None:
    """Mark an object that `build_object` made, with its picture from the front as preview."""
    made.asset_mark()
    made.asset_data.description = "Relightable mesh made from pictures"
    made.asset_data.tags.new("relightable", skip_if_exists=True)
    pixels = picture(asset)
    preview = made.preview_ensure()
    preview.image_size = (SIDE, SIDE)
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(pixels[::-1]).ravel())


@torch.inference_mode()
def picture(asset: RelightableAsset) -> NDArray[np.float32]:
    """(SIDE, SIDE, 4) sRGB with straight alpha: the baked colour, seen from the front, right and above."""
    vertices = asset.mesh.vertices
    low, high = vertices.amin(dim=0), vertices.amax(dim=0)
    radius = (vertices - (low + high) / 2.0).norm(dim=1).max().clamp(min=1e-6)
    unit = (vertices - (low + high) / 2.0) / radius
    camera = zero123plus_rig(distance=4.0, fovy_deg=30.0, size=2 * SIDE)[0]  # sin 15 degrees is just over 1 / 4.
    fragments = rasterize(unit, asset.mesh.faces, camera)
    rgba = unit.new_zeros(4, 2 * SIDE, 2 * SIDE)
    uv = interpolate(asset.mesh.uvs, asset.mesh.face_uvs, fragments)[:, fragments.mask].T
    rgba[:3, fragments.mask] = sample_texture(asset.maps.baked, uv).T
    rgba[3, fragments.mask] = 1.0
    small = torch.nn.functional.avg_pool2d(rgba[None], 2)[0]  # Premultiplied: outside, the colour is 0.
    color = srgb_from_linear(small[:3] / small[3:].clamp(min=1e-6))
    return torch.cat([color, small[3:]]).clamp(0.0, 1.0).permute(1, 2, 0).numpy()
