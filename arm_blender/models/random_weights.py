"""Random weights for tests: all networks of a preset run at their true size where no trained weights are there.

Matrices and kernels keep the variance of what goes through them (LeCun et al. 1998), so that the outputs depend on
the views, as a trained network's do, and do not fade to a constant on their way. The learned tokens of the triplane
are drawn on a coarse grid and interpolated: the field is then smooth, and what it dents can be unwrapped.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .transformer import TriplaneTransformer

TOKEN_DEVIATION = 0.02
"""Of class tokens and position embeddings: what DINO's training begins with."""

PLANE_CELLS = 3
"""Of the coarse grid along a side of a plane. More make a surface of many small dents."""

Field = Callable[[Tensor], Tensor]
"""(P, 3) world points to (P,), of one object."""

RADIUS, DENTS = 0.6, 0.03
"""Of the ball that a random field dents, and how deep it does so in the mean; world units."""

_PROBES = 2**12


def random_state(module: nn.Module, seed: int) -> dict[str, Tensor]:
    """A state dict of float32 tensors on the CPU for a network, which may be on the meta device.

    Args:
        module: a network without batch normalisation.
        seed: the same one gives the same tensors; random numbers of the caller's stay untouched.
    """
    generator = torch.Generator().manual_seed(seed)
    state: dict[str, Tensor] = {}
    for path, part in module.named_modules():
        for name, parameter in part.named_parameters(recurse=False):
            state[f"{path}.{name}" if path else name] = _values(part, name, parameter.shape, generator)
    return state


def dented_ball(field: Field, chunk: int, device: torch.device | str) -> Field:
    """A field with a surface, at 0: a ball whose distance is moved by a random field, made to vary by `DENTS`.

    A random field has no surface of its own that an object could have: where it has a value, it has it everywhere.

    Args:
        field: of a network with random weights.
        chunk: points asked at once.
        device: of the points.
    """
    generator = torch.Generator().manual_seed(0)
    points = RADIUS * (2.0 * torch.rand(_PROBES, 3, generator=generator) - 1.0)
    values = torch.cat([field(part.to(device)) for part in points.split(chunk)])
    mean, deviation = values.mean(), values.std().clamp(min=torch.finfo(values.dtype).tiny)
    return lambda points: RADIUS - points.norm(dim=1) + DENTS * (field(points) - mean) / deviation


def _values(part: nn.Module, name: str, shape: torch.Size, generator: torch.Generator) -> Tensor:
    if isinstance(part, nn.LayerNorm | nn.GroupNorm):
        return torch.ones(shape) if name == "weight" else torch.zeros(shape)
    if isinstance(part, TriplaneTransformer):
        grid, width = part.config.grid, part.config.width
        coarse = torch.randn(3, width, PLANE_CELLS, PLANE_CELLS, generator=generator)
        fine = F.interpolate(coarse, (grid, grid), mode="bicubic", align_corners=True)
        return fine.flatten(2).transpose(1, 2).reshape(shape)
    if not isinstance(part, nn.Linear | nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d | nn.ConvTranspose3d):
        return TOKEN_DEVIATION * torch.randn(shape, generator=generator)
    if name == "bias":
        return torch.zeros(shape)
    return torch.empty(shape).normal_(0.0, shape[1:].numel() ** -0.5, generator=generator)
