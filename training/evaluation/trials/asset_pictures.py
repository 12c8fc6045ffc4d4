"""What an asset shows from the test views: its maps, by our rasteriser."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn import functional

from arm_blender.graphics.cameras import Camera
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.graphics.raster.rasterize import Fragments, interpolate, rasterize
from arm_blender.graphics.textures import sample_texture
from arm_blender.structures import RelightableAsset, TriangleMesh, UvMesh

from ..truth.truth import Appearance

OVERSAMPLING = 2
"""Samples of a pixel along a side, for the truth's are means over a pixel."""


@torch.no_grad()
def map_pictures(asset: RelightableAsset, cameras: Sequence[Camera]) -> Appearance:
    """Albedo, roughness and metallic of an asset as the cameras see them; it is not lit."""
    mesh, maps = asset.mesh, asset.maps

    def values(fragments: Fragments) -> Tensor:
        uv = interpolate(mesh.uvs, mesh.face_uvs, fragments)[:, fragments.mask].T
        return torch.cat([sample_texture(maps.image(name), uv) for name in ("albedo", "roughness", "metallic")], dim=1)

    return _pictures([_drawn(mesh, camera, values) for camera in cameras], cameras)


@torch.no_grad()
def vertex_pictures(
    mesh: TriangleMesh, colors: Tensor, finish: tuple[float, float], cameras: Sequence[Camera]
) -> Appearance:
    """The same of a mesh with linear colours (N, 3) at its vertices, and one roughness and metallic."""

    def values(fragments: Fragments) -> Tensor:
        color = interpolate(colors, mesh.faces, fragments)[:, fragments.mask].T
        return torch.cat([color, color.new_tensor(finish).expand(len(color), 2)], dim=1)

    return _pictures([_drawn(mesh, camera, values) for camera in cameras], cameras)


def _drawn(mesh: UvMesh | TriangleMesh, camera: Camera, values: Callable[[Fragments], Tensor]) -> Tensor:
    """(6, H, W): premultiplied linear values (5) and coverage; `values` gives (P, 5) of the covered pixels."""
    fine = camera.resized(OVERSAMPLING * camera.width, OVERSAMPLING * camera.height)
    fragments = rasterize(mesh.vertices, mesh.faces, fine)
    picture = torch.zeros(6, fine.height, fine.width)
    picture[:5, fragments.mask] = values(fragments).T
    picture[5] = fragments.mask.float()
    return functional.avg_pool2d(picture[None], OVERSAMPLING)[0]


def _pictures(drawn: list[Tensor], cameras: Sequence[Camera]) -> Appearance:
    premultiplied = torch.stack(drawn)
    alpha = premultiplied[:, 5:]
    straight = premultiplied[:, :5] / alpha.clamp(min=1e-6)
    return Appearance(tuple(cameras), alpha, srgb_from_linear(straight[:, :3]), straight[:, 3:4], straight[:, 4:5])
