"""Light that nine spherical harmonics tell: what a surface sends back of it, and an environment that has them.

Nothing hides it from anything, and no surface lights another.
"""

import functools

import torch
from torch import Tensor
from torch.nn import functional

from .brdf import DIELECTRIC_F0
from .environment import Environment
from .specular_albedo import specular_albedo
from .spherical_harmonics import COUNT, WHITE, gathered, harmonics

HEIGHT = 64
"""Texels from the zenith to the nadir of an environment: what nine harmonics tell is far smoother."""

_ORDERS = (0, 1, 1, 1, 2, 2, 2, 2, 2)
"""Of the harmonics."""

_STIFF = 1e-3
"""Share of its exponent's coefficients by which an environment may miss the harmonics: those of no light that is >= 0
would have it grow without bound."""

_SHARPEST = 0.98
"""Of what a single star has of an order, the share that an environment has at most: sharper light there is none."""

_DARKEST = 1e-4
"""Mean radiance of a channel at least."""

_ROUGHNESSES, _ROUNDS = 64, 60


def shade(normal: Tensor, view: Tensor, albedo: Tensor, roughness: Tensor, metallic: Tensor, light: Tensor) -> Tensor:
    """What points send to the camera: irradiance for the diffuse layer, and for the lobe above it the light around its
    middle, as wide as the lobe is where it is seen from above (Karis 2013).

    Args:
        normal, view: (P, 3) unit, the latter to the camera. albedo: (P, 3). roughness, metallic: (P, 1).
        light: (9, 3), as of `spherical_harmonics.gathered`.
    Returns:
        (P, 3) radiance, at least 0.
    """
    n_dot_v = (normal * view).sum(dim=1, keepdim=True)
    mirrored = 2.0 * n_dot_v * normal - view
    # The middle of a rough lobe leans to the normal; by alpha, what comes to 5 % of the integral at all roughnesses.
    middle = functional.normalize(torch.lerp(mirrored, normal, roughness.square()), dim=1)
    n_dot_v = n_dot_v.clamp(min=0.0)
    plain = torch.full_like(n_dot_v, DIELECTRIC_F0)
    diffuse = (1.0 - metallic) * (1.0 - specular_albedo(n_dot_v, roughness, plain)) * albedo
    f0 = metallic * albedo + (1.0 - metallic) * DIELECTRIC_F0
    around = ((harmonics(middle) * lobe(roughness)) @ light).clamp(min=0.0)
    return diffuse * (gathered(normal) @ light).clamp(min=0.0) + specular_albedo(n_dot_v, roughness, f0) * around


def lobe(roughness: Tensor) -> Tensor:
    """(P, 9): what a GGX lobe leaves of each harmonic, of roughness (P, 1) in [0, 1], perceptual.

    A mirror leaves all of them; at roughness 1 it is a cosine lobe, which leaves `GATHERED`.
    """
    table = _lobes().to(roughness)
    x = roughness.clamp(0.0, 1.0) * (_ROUGHNESSES - 1)
    low = x.floor().clamp(max=_ROUGHNESSES - 2)
    row = low[:, 0].long()
    orders = table[row] + (x - low) * (table[row + 1] - table[row])
    return orders[:, list(_ORDERS)]


@functools.cache
def _lobes() -> Tensor:
    """(_ROUGHNESSES, 3) float64, by order: the mean of Legendre's polynomials over the lobe seen from above."""
    alpha = torch.linspace(0.0, 1.0, _ROUGHNESSES, dtype=torch.float64)[:, None].square()
    drawn = (torch.arange(4096, dtype=torch.float64) + 0.5) / 4096
    # GGX's half-way vectors, drawn as their density times cosine; light comes from twice as far off the normal.
    half = (1.0 - drawn) / (1.0 + (alpha.square() - 1.0) * drawn)  # The cosine's square.
    cosine = 2.0 * half - 1.0
    weight = cosine.clamp(min=0.0)
    orders = torch.stack([torch.ones_like(cosine), cosine, 1.5 * cosine.square() - 0.5], dim=2)
    return (orders * weight[..., None]).sum(dim=1) / weight.sum(dim=1, keepdim=True)


def harmonics_of(environment: Environment) -> Tensor:
    """(9, 3): the integrals of an environment's radiance times each harmonic."""
    lights = environment.texels()
    return harmonics(lights.direction).T @ lights.power


@torch.no_grad()
def environment_of(light: Tensor, height: int = HEIGHT) -> Environment:
    """The most even environment, nowhere negative, that has these harmonics: radiance of most entropy.

    What nine harmonics add up to themselves is negative across from a strong light. The exponential of nine is not; its
    coefficients are found by Newton's method (the dual of most entropy is convex). Harmonics that no light has are met
    as nearly as `_STIFF` lets them.

    Args:
        light: (9, 3).
        height: texels; there are twice as many across.
    """
    if light.shape != (COUNT, 3):
        raise ValueError(f"light ({COUNT}, 3) expected, got {tuple(light.shape)}")
    texels = Environment(torch.ones(3, height, 2 * height)).texels()
    basis, share = harmonics(texels.direction).double(), texels.power[:, 0].double()
    mean = (light[0].detach().cpu().double() / WHITE).clamp(min=_DARKEST)
    wanted = light.detach().cpu().double() / mean
    wanted[0] = WHITE
    for order in (1, 2):
        own = torch.tensor([of == order for of in _ORDERS])
        star = WHITE * (2 * order + 1) ** 0.5
        wanted[own] *= (_SHARPEST * star / wanted[own].norm(dim=0).clamp(min=1e-12)).clamp(max=1.0)
    radiance = torch.stack([(basis @ _exponent(basis, share, one)).exp() for one in wanted.T])
    return Environment((radiance * mean[:, None]).float().view(3, height, 2 * height))


def _exponent(basis: Tensor, share: Tensor, wanted: Tensor) -> Tensor:
    """(9,) of a function on texels (N, 9), of `share` (N,) steradians, whose exponential has harmonics `wanted`."""

    def missed(a: Tensor) -> Tensor:
        return (share * (basis @ a).clamp(max=60.0).exp()).sum() - a @ wanted + 0.5 * (stiff * a) @ a

    stiff = torch.full_like(wanted, _STIFF)
    stiff[0] = 0.0  # How bright it is in the mean is met by any light.
    a = torch.zeros_like(wanted)
    for _ in range(_ROUNDS):
        power = share * (basis @ a).clamp(max=60.0).exp()
        slope = basis.T @ power - wanted + stiff * a
        if float(slope.abs().max()) < 1e-9:
            break
        step = torch.linalg.solve((basis * power[:, None]).T @ basis + torch.diag(stiff), slope)
        length, before = 1.0, missed(a)
        while length > 1e-6 and float(missed(a - length * step)) > float(before - 1e-4 * length * (slope @ step)):
            length *= 0.5
        a = a - length * step
    return a
