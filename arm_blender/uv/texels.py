"""Where on the surface each texel of an atlas lies."""

import torch

from ..graphics.meshes import face_normals, vertex_normals
from ..graphics.raster.rasterize import interpolate, rasterize_uv
from ..structures import TexelMap, UvMesh


@torch.no_grad()
def texel_map(mesh: UvMesh, size: int) -> TexelMap:
    """The surface point and the smooth normal of every texel of an atlas of `size` texels a side.

    Raises:
        ValueError: `size` is not positive.
    """
    if size < 1:
        raise ValueError(f"an atlas needs at least one texel a side, got {size}")
    fragments = rasterize_uv(mesh.uvs, mesh.face_uvs, size)
    position = interpolate(mesh.vertices, mesh.faces, fragments)
    smooth = interpolate(vertex_normals(mesh.vertices, mesh.faces), mesh.faces, fragments)
    length = smooth.square().sum(dim=0).sqrt()
    normal = smooth / length.clamp(min=1e-3)
    # Where opposite normals cancel (a fin without thickness), the face's own is the only one that means anything.
    cancelled = (length <= 1e-3) & fragments.mask
    normal[:, cancelled] = face_normals(mesh.vertices, mesh.faces)[fragments.face_id[cancelled]].T
    return TexelMap(position, normal, fragments.mask)
