"""How near a predicted light comes to the true one: by the irradiance that the visible surface gets of each."""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from arm_blender.graphics.color import LUMINANCE
from arm_blender.graphics.light.environment import Environment
from arm_blender.graphics.light.harmonic_light import harmonics_of
from arm_blender.graphics.light.spherical_harmonics import WHITE, gathered
from arm_blender.graphics.meshes import vertex_normals
from arm_blender.graphics.raster.rasterize import interpolate, rasterize
from arm_blender.structures import TriangleMesh, ViewSet

from ...rasterized.lights import read_radiance


@dataclass(frozen=True)
class LightScores:
    """Of the light that a run took off the views.

    Attributes:
        irradiance: dB, as of `irradiance_psnr`.
        rerendering: dB of the inputs drawn under it, as the run's report has it (`light_check.rerendering`).
    """

    irradiance: float
    rerendering: float


def irradiance_psnr(found: Tensor, true: Tensor, normals: Tensor) -> float:
    """PSNR in dB of irradiance over pi, linear, of which 1 is the peak: what makes white matte things white.

    Nothing is scaled, and nothing hidden.

    Args:
        found, true: (9, 3), as of `spherical_harmonics.gathered`.
        normals: (P, 3) unit, at which it is asked.
    """
    basis = gathered(normals)
    error = (basis @ found).clamp(min=0.0) - (basis @ true).clamp(min=0.0)
    return -10.0 * math.log10(max(float(error.square().mean()), 1e-12))


def true_light(hdri: Path, exposure: float) -> Tensor:
    """(9, 3) of an environment brought to a mean luminance over the sphere of `exposure`, as the views were lit."""
    light = harmonics_of(Environment(read_radiance(hdri)))
    return light * (exposure * WHITE / (light[0] @ torch.tensor(LUMINANCE)))


def seen_normals(surface: TriangleMesh, views: ViewSet) -> Tensor:
    """(P, 3) unit normals of a surface at the pixels of the views, those that see it twice counted twice."""
    smooth, found = vertex_normals(surface.vertices, surface.faces), []
    for camera in views.cameras:
        fragments = rasterize(surface.vertices, surface.faces, camera)
        found.append(interpolate(smooth, surface.faces, fragments)[:, fragments.mask].T)
    return torch.nn.functional.normalize(torch.cat(found), dim=1)
