"""Real spherical harmonics up to order 2: smooth functions of direction, such as the light that a surface gathers.

Ramamoorthi and Hanrahan, "An efficient representation for irradiance environment maps" (SIGGRAPH 2001).
"""

import torch
from torch import Tensor

COUNT = 9
"""Of the harmonics."""

_CONSTANT = 0.2820948

WHITE = 1.0 / _CONSTANT
"""First coefficient of light of radiance 1 from everywhere; its others are 0."""

GATHERED = (1.0, 2.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, 0.25, 0.25, 0.25, 0.25, 0.25)
"""What a cosine lobe leaves of each, over pi: a white matte surface then sends as much radiance as comes in."""


def harmonics(direction: Tensor) -> Tensor:
    """(..., 9) of unit directions (..., 3)."""
    x, y, z = direction.unbind(dim=-1)
    first, second = 0.4886025, 1.0925484
    return torch.stack([
        torch.full_like(x, _CONSTANT), first * y, first * z, first * x, second * x * y, second * y * z,
        0.3153916 * (3.0 * z * z - 1.0), second * x * z, 0.5462742 * (x * x - y * y)
    ], dim=-1)  # fmt: skip


def gathered(normal: Tensor) -> Tensor:
    """(..., 9) of unit normals (..., 3): the product with a light (9, C) is irradiance over pi, nothing hidden.

    The light's coefficients are the integrals of its radiance times each harmonic.
    """
    return harmonics(normal) * normal.new_tensor(GATHERED)
