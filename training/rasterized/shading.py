"""What a lit surface sends to a camera, without tracing a ray.

Diffuse light is gathered at the vertices, from all directions that they see; mirrored light is looked up in the
prefiltered environment, as far as the surface sees that way (Karis 2013, the split sum); suns are shaded at every pixel
with the BRDF in the form of Cycles and cast shadows by z-buffers. What the object hides of the sky it replaces by its
own mean radiance: one bounce, roughly.
"""

import functools
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from arm_blender.graphics.light.brdf import DIELECTRIC_F0, evaluate
from arm_blender.graphics.light.specular_albedo import specular_albedo
from arm_blender.graphics.light.spherical_harmonics import harmonics
from arm_blender.graphics.raster.rasterize import rasterize_views

from .lights import Lighting, Sun, mirrored
from .materials import Finish
from .surface import DIRECTIONS, Surface, directions, sky_camera, unshadowed

SOFT = 4
"""Z-buffers of a sun that is not a point."""
POINT = 0.02
"""Radians. A smaller sun casts hard shadows."""


@dataclass(frozen=True)
class VertexLight:
    """What is known of the light at the vertices.

    Attributes:
        irradiance: (2 * N, 3) of the environment and of the object's own light, without suns; fronts, then backs.
        open: (2 * N, 9) spherical harmonics of the share of light that is not hidden, by direction.
        own: (3,) mean radiance of the object.
    """

    irradiance: Tensor
    open: Tensor
    own: Tensor


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a surface that are shaded.

    Attributes:
        point: (P, 3) world. normal: (P, 3) unit. view: (P, 3) unit, to the camera.
        irradiance: (P, 3). open: (P, 9). As in `VertexLight`.
        values: (P, 5) linear albedo, roughness, metallic.
    """

    point: Tensor
    normal: Tensor
    view: Tensor
    irradiance: Tensor
    open: Tensor
    values: Tensor


def light_vertices(surface: Surface, lighting: Lighting, finish: Finish) -> VertexLight:
    """The light that arrives at the vertices of a surface."""
    seen, normals = surface.visible.float(), torch.cat([surface.normals, -surface.normals])
    arriving = (normals @ lighting.cones.permute(1, 0, 2).flatten(1)).clamp_(min=0.0)  # (2 * N, D * 3)
    irradiance = (arriving.view(-1, DIRECTIONS, 3) * seen[..., None]).sum(dim=1)
    cosine = (normals @ directions().T).clamp_(min=0.0)
    hidden = 1.0 - (cosine * seen).sum(dim=1, keepdim=True) / cosine.sum(dim=1, keepdim=True).clamp(min=1e-6)
    direct = irradiance
    for sun in lighting.suns:
        reached = seen[:, (directions() @ sun.direction).argmax()] * (normals @ sun.direction).clamp(min=0.0)
        direct = direct + reached[:, None] * sun.power
    albedo = finish(surface.vertices, surface.normals, surface.part)[0][:, :3].repeat(2, 1)
    # What is not open, the inside above all, is not seen either.
    own = (albedo * direct * (1.0 - hidden)).sum(dim=0) / (1.0 - hidden).sum().clamp(min=1e-6) / math.pi
    return VertexLight(irradiance + math.pi * hidden * own, _open(normals, seen), own)


def shade(points: SurfacePoints, surface: Surface, lighting: Lighting, own: Tensor) -> Tensor:
    """(P, 3) radiance that points of a surface send to the camera; `own` (3,) as in `VertexLight`."""
    albedo, roughness, metallic = points.values.split((3, 1, 1), dim=1)
    n_dot_v = (points.normal * points.view).sum(dim=1, keepdim=True).clamp(0.0, 1.0)
    f0 = metallic * albedo + (1.0 - metallic) * DIELECTRIC_F0
    constant = torch.full_like(n_dot_v, DIELECTRIC_F0)
    sent = specular_albedo(n_dot_v, roughness, torch.cat([f0, torch.ones_like(n_dot_v), constant], dim=1))
    glossy, whole, coat = sent.split((3, 1, 1), dim=1)
    # What the lobe loses between the facets comes out after further reflections (Turquin 2019), as Principled does.
    glossy = glossy * (1.0 + f0 * (1.0 / whole.clamp(min=1e-2) - 1.0))
    color = (1.0 - metallic) * albedo * (1.0 - coat) * points.irradiance / math.pi
    reflected = 2.0 * n_dot_v * points.normal - points.view
    seen = (points.open * harmonics(reflected)).sum(dim=1, keepdim=True).clamp(0.0, 1.0)
    color = color + glossy * (seen * mirrored(lighting.levels, reflected, roughness) + (1.0 - seen) * own)
    for sun in lighting.suns:
        color = color + _sunlight(points, surface, sun)
    return color


def _open(normals: Tensor, seen: Tensor) -> Tensor:
    """(2 * N, 9): how much of the sky each vertex sees, by direction.

    Below its tangent plane it counts as seeing as much as above in the mean: no reflection leads there, and smooth
    harmonics would let what is hidden there darken reflections that just clear the plane. An open surface has 1.
    """
    above = normals @ directions().T > 0.0
    share = (seen * above).sum(dim=1, keepdim=True) / above.sum(dim=1, keepdim=True).clamp(min=1)
    return torch.where(above, seen, share) @ (_basis() * (4.0 * math.pi / DIRECTIONS))


@functools.cache
def _basis() -> Tensor:
    """(D, 9) harmonics of the sky's directions."""
    return harmonics(directions())


def _sunlight(points: SurfacePoints, surface: Surface, sun: Sun) -> Tensor:
    """(P, 3) radiance from one sun."""
    cosine = points.normal @ sun.direction
    facing = (cosine > 0.0).nonzero()[:, 0]
    color = torch.zeros_like(points.point)
    if not len(facing):
        return color
    point, normal = points.point[facing], points.normal[facing]
    cameras = [sky_camera(direction) for direction in _spread(sun)]
    depth = rasterize_views(surface.vertices, surface.faces, cameras).depth
    lit = [unshadowed(point, normal, d, camera) for d, camera in zip(depth, cameras, strict=True)]
    share = torch.stack(lit).sum(dim=0) / len(cameras)
    reached = (share > 0.0).nonzero()[:, 0]
    facing, share = facing[reached], share[reached]
    albedo, roughness, metallic = points.values[facing].split((3, 1, 1), dim=1)
    # The lobe of a light with an extent is as wide as both (Karis 2013); its peak stays that of a normalised one.
    roughness = (roughness.square() + 0.5 * math.tan(sun.radius)).clamp(max=1.0).sqrt()
    light = sun.direction.expand(len(facing), 3)
    brdf = evaluate(points.normal[facing], light, points.view[facing], albedo, roughness, metallic, "cycles")
    return color.index_copy(0, facing, brdf * (cosine[facing] * share)[:, None] * sun.power)


def _spread(sun: Sun) -> Tensor:
    """(S, 3) unit directions over the disc of a sun."""
    if sun.radius < POINT:
        return sun.direction[None]
    side = torch.linalg.cross(sun.direction, torch.eye(3)[sun.direction.abs().argmin()])
    frame = torch.stack([side, torch.linalg.cross(sun.direction, side)])
    angle = 2.0 * math.pi * (torch.arange(SOFT) + 0.25) / SOFT
    aside = 0.7 * math.tan(sun.radius) * torch.stack([angle.cos(), angle.sin()], dim=1) @ frame
    return torch.nn.functional.normalize(sun.direction + aside, dim=1)
