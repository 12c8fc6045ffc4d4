"""An asset under light of nine harmonics, as cameras see it: no shadows, no light from one surface to another."""

import torch
from torch import Tensor
from torch.nn import functional

from ..graphics.cameras import Camera, view_directions
from ..graphics.color import srgb_from_linear
from ..graphics.light.harmonic_light import shade
from ..graphics.meshes import angle_weighted_normals, face_normals
from ..graphics.raster.rasterize import Fragments, interpolate, rasterize
from ..graphics.textures import sample_texture
from ..structures import MaterialMaps, UvMesh
from ..uv.normal_map import tangent_frame


class Drawing:
    """An asset made ready to be drawn.

    Args:
        mesh: with its atlas.
        maps: as they are to be seen, finishes in them.
        coarser: texels of a map that become one along each side: as many as a pixel has, for a small picture.
    """

    def __init__(self, mesh: UvMesh, maps: MaterialMaps, coarser: int = 1) -> None:
        self.mesh, self.maps = mesh, maps
        self.normals = angle_weighted_normals(mesh.vertices, mesh.faces)
        self.sides = face_normals(mesh.vertices, mesh.faces)
        self.albedo, self.rough, self.metal = (
            _coarser(maps.image(name), coarser) for name in ("albedo", "roughness", "metallic")
        )

    def under(self, light: Tensor, camera: Camera, gain: Tensor | None = None) -> Tensor:
        """What a camera takes.

        Args:
            light: (9, 3), as of `spherical_harmonics.gathered`.
            gain: (3,) what would bring the camera's colours to the light's exposure; None where they have it.
        Returns:
            (4, H, W) sRGB, straight alpha of 0 or 1; 0 where nothing is.
        """
        fragments = rasterize(self.mesh.vertices, self.mesh.faces, camera)
        there = fragments.mask
        position = interpolate(self.mesh.vertices, self.mesh.faces, fragments)[:, there].T
        uv = interpolate(self.mesh.uvs, self.mesh.face_uvs, fragments)[:, there].T
        view = view_directions(position, camera)
        normal = self._normal(fragments, uv)
        behind = (self.sides[fragments.face_id[there]] * view).sum(dim=1, keepdim=True) < 0.0
        normal = torch.where(behind, -normal, normal)
        albedo, rough, metal = (sample_texture(texels, uv) for texels in (self.albedo, self.rough, self.metal))
        radiance = shade(normal, view, albedo, rough, metal, light)
        picture = position.new_zeros(4, *there.shape)
        picture[:3, there] = srgb_from_linear(radiance if gain is None else radiance / gain).T
        picture[3, there] = 1.0
        return picture

    def _normal(self, fragments: Fragments, uv: Tensor) -> Tensor:
        """(P, 3) unit normals where the asset is, with the detail of a normal map."""
        smooth = interpolate(self.normals, self.mesh.faces, fragments)[:, fragments.mask].T
        if self.maps.normal is None:
            return functional.normalize(smooth, dim=1)
        tangent, bitangent = tangent_frame(self.mesh, self.normals, fragments, smooth)
        across, along, up = sample_texture(self.maps.normal, uv).split(1, dim=1)
        return functional.normalize(across * tangent + along * bitangent + up * smooth, dim=1)


def _coarser(texels: Tensor, factor: int) -> Tensor:
    """(C, T / factor, T / factor) means of (C, T, T); as it is where it has no more than a few."""
    factor = min(factor, texels.shape[-1])
    return texels if factor <= 1 else functional.avg_pool2d(texels[None], factor)[0]
