"""The microfacet BRDF of ARM (supplement, "Detailed explanation"): GGX, Schlick-GGX, Schlick's Fresnel.

The paper prints three terms that cannot be meant: D without the square on n.h does not normalise, k differs from
its source (Karis 2013), and the diffuse term keeps the light that the surface has already mirrored, so that a white
furnace gains energy. The standard forms are the default; "printed" evaluates what stands in the paper, and "cycles"
what Blender's Principled BSDF renders: Smith's height-correlated shadowing, and a diffuse layer that gets what the
lobe above it leaves.
"""

import math
from typing import Literal

import torch
from torch import Tensor

from .specular_albedo import specular_albedo

Form = Literal["standard", "printed", "cycles"]

MIN_COSINE = 1e-4  # Cosines are not smaller: the denominators and their gradients stay finite at grazing angles.
MIN_ALPHA = 1e-3  # alpha = roughness**2 is not smaller: D of a perfect mirror has no finite value.
DIELECTRIC_F0 = 0.04


def distribution(gap: Tensor, roughness: Tensor, printed: bool = False) -> Tensor:
    """GGX density of microfacet normals (Walter et al. 2007), per steradian; D (n.h) integrates to 1.

    Args:
        gap: 1 - n.h, of the normal and the half-way vector. Not n.h: close to 1, float32 has no digits left for the
            angle within which a mirror's lobe lies.
        roughness: perceptual, in [0, 1]; alpha = roughness**2.
        printed: n.h without its square in the denominator, as in the paper.
    """
    gap = gap.clamp(0.0, 1.0 - MIN_COSINE)
    alpha_squared = _alpha(roughness) ** 2
    rest = gap if printed else gap * (2.0 - gap)  # 1 - c of c = n.h, or of its square.
    # c (alpha**2 - 1) + 1 cancels for smooth surfaces; this sum of two positive terms is the same and does not.
    return alpha_squared / (math.pi * ((1.0 - rest) * alpha_squared + rest) ** 2)


def geometry(n_dot_l: Tensor, n_dot_v: Tensor, roughness: Tensor, printed: bool = False) -> Tensor:
    """Share of microfacets neither shadowed nor masked (Schlick-GGX), in [0, 1].

    Args:
        n_dot_l: cosine between the normal and the light.
        n_dot_v: cosine between the normal and the view.
        roughness: perceptual, in [0, 1].
        printed: k = (roughness**2 + 1)**2 / 8 as in the paper, not Karis' (roughness + 1)**2 / 8.
    """
    k = ((roughness**2 if printed else roughness) + 1.0) ** 2 / 8.0
    n_dot_l, n_dot_v = n_dot_l.clamp(MIN_COSINE, 1.0), n_dot_v.clamp(MIN_COSINE, 1.0)
    return n_dot_l / (n_dot_l * (1.0 - k) + k) * (n_dot_v / (n_dot_v * (1.0 - k) + k))


def fresnel(h_dot_v: Tensor, f0: Tensor) -> Tensor:
    """Mirrored share of the light (Schlick), in [f0, 1].

    Args:
        h_dot_v: cosine between the half-way vector and the view; broadcasts with `f0`.
        f0: share at normal incidence.
    """
    return f0 + (1.0 - f0) * (1.0 - h_dot_v.clamp(0.0, 1.0)) ** 5


def correlated_geometry(n_dot_l: Tensor, n_dot_v: Tensor, roughness: Tensor) -> Tensor:
    """As `geometry`, by Smith's height-correlated form for GGX (Heitz 2014, equation 99)."""
    n_dot_l, n_dot_v = n_dot_l.clamp(MIN_COSINE, 1.0), n_dot_v.clamp(MIN_COSINE, 1.0)
    square = _alpha(roughness) ** 2
    light = n_dot_v * (square + (1.0 - square) * n_dot_l**2).sqrt()
    view = n_dot_l * (square + (1.0 - square) * n_dot_v**2).sqrt()
    return 2.0 * n_dot_l * n_dot_v / (light + view)


def evaluate(
    normal: Tensor,
    light: Tensor,
    view: Tensor,
    albedo: Tensor,
    roughness: Tensor,
    metallic: Tensor,
    form: Form = "standard",
) -> Tensor:
    """The BRDF without the cosine of the light; 0 where light or view lies below the surface.

    All leading shapes broadcast. Computed in float32 at least: half precision cannot hold the lobe of a mirror.

    Args:
        normal: (..., 3) unit.
        light: (..., 3) unit, from the surface to the light.
        view: (..., 3) unit, from the surface to the camera.
        albedo: (..., 3) linear base colour in [0, 1].
        roughness: (..., 1) perceptual, in [0, 1].
        metallic: (..., 1) in [0, 1].
        form: of the formulas. "cycles" alone may not exchange light and view.
    Returns:
        (..., 3) per steradian.
    """
    inputs = (normal, light, view, albedo, roughness, metallic)
    normal, light, view, albedo, roughness, metallic = (
        x.float() if x.dtype in (torch.float16, torch.bfloat16) else x for x in inputs
    )
    n_dot_l = (normal * light).sum(dim=-1, keepdim=True)
    n_dot_v = (normal * view).sum(dim=-1, keepdim=True)
    half = light + view
    # Opposite directions have no half-way vector; both cannot lie above the surface, so any finite one will do.
    half = half / (half * half).sum(dim=-1, keepdim=True).clamp(min=1e-12).sqrt()
    f0 = metallic * albedo + (1.0 - metallic) * DIELECTRIC_F0
    mirrored = fresnel((half * view).sum(dim=-1, keepdim=True), f0)
    gap = 0.5 * ((normal - half) ** 2).sum(dim=-1, keepdim=True)
    facets = distribution(gap, roughness, form == "printed")
    if form == "cycles":
        unblocked = correlated_geometry(n_dot_l, n_dot_v, roughness)
    else:
        unblocked = geometry(n_dot_l, n_dot_v, roughness, form == "printed")
    above = 4.0 * n_dot_l.clamp(min=MIN_COSINE) * n_dot_v.clamp(min=MIN_COSINE)
    glossy = facets * unblocked * mirrored / above
    diffuse = (1.0 - metallic) * albedo / math.pi
    if form == "cycles":
        diffuse = diffuse * (1.0 - specular_albedo(n_dot_v, roughness, torch.full_like(n_dot_v, DIELECTRIC_F0)))
    elif form == "standard":
        # What enters the surface and what leaves it. 1 - F(h.v) alone would still gain energy at grazing angles.
        diffuse = diffuse * (1.0 - fresnel(n_dot_l, f0)) * (1.0 - fresnel(n_dot_v, f0))
    return torch.where((n_dot_l > 0.0) & (n_dot_v > 0.0), diffuse + glossy, torch.zeros_like(glossy))


def _alpha(roughness: Tensor) -> Tensor:
    return (roughness**2).clamp(min=MIN_ALPHA)
