"""How much of the light a GGX lobe sends back in all: what a layer beneath it cannot get.

The lobe's directional albedo is linear in the reflectance at normal incidence under Schlick's Fresnel (Karis 2013,
the "environment BRDF"): f0 * scale + bias, both functions of the view's cosine and of roughness alone.
"""

import functools
import math

import torch
from torch import Tensor

COSINES, ROUGHNESSES, SAMPLES = 48, 32, 1024


def specular_albedo(n_dot_v: Tensor, roughness: Tensor, f0: Tensor) -> Tensor:
    """The share of uniform light that the lobe reflects towards the view, in [0, 1]; differentiable in all three.

    Args:
        n_dot_v: (..., 1) cosine between normal and view.
        roughness: (..., 1) perceptual, in [0, 1].
        f0: (..., C) mirrored share at normal incidence.
    """
    table = _table().to(n_dot_v)  # (2, ROUGHNESSES, COSINES)
    n_dot_v, roughness = torch.broadcast_tensors(n_dot_v, roughness)
    # The table is finest at grazing angles, where the albedo bends.
    x = n_dot_v.clamp(1e-8, 1.0).sqrt() * (COSINES - 1)
    y = roughness.clamp(0.0, 1.0) * (ROUGHNESSES - 1)
    column, row = x.detach().floor().clamp(max=COSINES - 2), y.detach().floor().clamp(max=ROUGHNESSES - 2)
    right, down, i, j = x - column, y - row, row.long(), column.long()
    scale, bias = (
        (1.0 - down) * ((1.0 - right) * t[i, j] + right * t[i, j + 1])
        + down * ((1.0 - right) * t[i + 1, j] + right * t[i + 1, j + 1])
        for t in table
    )
    return f0 * scale + bias


@functools.cache
def _table() -> Tensor:
    """(2, ROUGHNESSES, COSINES) float64 scale and bias."""
    # Row by row, which stays in the cache: half the time.
    return torch.cat([_rows(one) for one in torch.linspace(0.0, 1.0, ROUGHNESSES, dtype=torch.float64).split(1)], dim=1)


def _rows(roughness: Tensor) -> Tensor:
    """(2, R, COSINES) of the table, for (R,) values of roughness, by sampling the visible normals (Heitz 2018)."""
    n_dot_v = torch.linspace(0.0, 1.0, COSINES, dtype=torch.float64).square().clamp(min=1e-8)[None, :, None]
    roughness = roughness[:, None, None]
    alpha = roughness.square().clamp(min=1e-3)
    index = torch.arange(SAMPLES, dtype=torch.float64)
    # A Fibonacci lattice: evener than strata.
    radius, phi = ((index + 0.5) / SAMPLES).sqrt(), math.pi * (1.0 + 5.0**0.5) * index
    # The view, stretched so that alpha is 1; normals are drawn from the disc that it sees.
    stretched = torch.stack(torch.broadcast_tensors(alpha * (1.0 - n_dot_v**2).clamp(min=0.0).sqrt(), n_dot_v))
    sine, cosine = stretched / stretched.norm(dim=0)
    a, b = radius * phi.cos(), radius * phi.sin()
    lift = 0.5 * (1.0 + cosine)
    # Across the plane of incidence is `a`, in it is `b`: the half of the disc that faces away is foreshortened.
    b = (1.0 - lift) * (1.0 - a**2).sqrt() + lift * b
    c = (1.0 - a**2 - b**2).clamp(min=0.0).sqrt()
    normal = torch.stack([
        alpha * (sine * c - cosine * b), (alpha * a).expand_as(b), (cosine * c + sine * b).clamp(min=0.0)
    ])  # fmt: skip
    normal = normal / normal.norm(dim=0)
    view_sine = (1.0 - n_dot_v**2).clamp(min=0.0).sqrt()
    h_dot_v = (normal[0] * view_sine + normal[2] * n_dot_v).clamp(0.0, 1.0)
    n_dot_l = 2.0 * h_dot_v * normal[2] - n_dot_v

    def masked(cosine: Tensor) -> Tensor:
        """Smith's Lambda."""
        return 0.5 * ((1.0 + alpha**2 * (1.0 / cosine**2 - 1.0)).sqrt() - 1.0)

    above = n_dot_l > 0.0
    shadowed = (1.0 + masked(n_dot_v)) / (1.0 + masked(n_dot_v) + masked(torch.where(above, n_dot_l, 1.0)))
    weight = torch.where(above, shadowed, 0.0)
    grazing = (1.0 - h_dot_v) ** 5
    return torch.stack([(weight * (1.0 - grazing)).mean(dim=2), (weight * grazing).mean(dim=2)])
