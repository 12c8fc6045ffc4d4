"""How well an asset reproduces the views that it was made from: its baked colour, rendered and compared."""

import math

import torch

from arm_blender.graphics.color import srgb_from_linear
from arm_blender.graphics.raster.rasterize import interpolate, rasterize
from arm_blender.graphics.textures import sample_texture
from arm_blender.structures import RelightableAsset, ViewSet

OPAQUE = 0.99
"""Coverage of the pixels that are compared: others mix the object with what is behind it."""


@torch.no_grad()
def rerender_psnr(asset: RelightableAsset, views: ViewSet) -> float:
    """PSNR in dB, in sRGB, over all pixels of all views that show the object and are covered by the asset.

    Args:
        asset: in the frame of the cameras.
        views: linear, straight alpha.
    Returns:
        infinity where all agree, NaN where there is nothing to compare.
    """
    squared, count = 0.0, 0
    for image, camera in zip(views.images, views.cameras, strict=True):
        fragments = rasterize(asset.mesh.vertices, asset.mesh.faces, camera)
        compared = fragments.mask & (image[3] >= OPAQUE)
        uv = interpolate(asset.mesh.uvs, asset.mesh.face_uvs, fragments)[:, compared].T
        found = sample_texture(asset.maps.baked, uv)
        error = srgb_from_linear(found) - srgb_from_linear(image[:3, compared].T)
        squared += float(error.double().square().sum())
        count += error.numel()
    if not count:
        return math.nan
    return math.inf if squared == 0.0 else -10.0 * math.log10(squared / count)
