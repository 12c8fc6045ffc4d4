"""Reading a texture at UVs."""

import torch
from torch import Tensor
from torch.nn import functional as F


def sample_texture(texture: Tensor, uv: Tensor) -> Tensor:
    """(P, C) bilinear values of `texture` (C, T, T), row 0 of which is v = 1, at `uv` (P, 2)."""
    grid = torch.stack([2.0 * uv[:, 0] - 1.0, 1.0 - 2.0 * uv[:, 1]], dim=1)
    found = F.grid_sample(texture[None], grid[None, :, None], padding_mode="border", align_corners=False)
    return found[0, :, :, 0].T
