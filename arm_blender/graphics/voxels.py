"""Values in the cells of the box [-1, 1]^3: where the cells are, and what lies between their centres."""

import torch
from torch import Tensor
from torch.nn import functional as F


def cell_centers(grid: int, device: torch.device) -> Tensor:
    """(grid**3, 3) world centres of the cells, x fastest."""
    axis = (torch.arange(grid, device=device) + 0.5) / grid * 2.0 - 1.0
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    return torch.stack([x, y, z], dim=-1).reshape(-1, 3)


def sample_volume(volume: Tensor, points: Tensor) -> Tensor:
    """(B, P, C) trilinear features of a volume (B, C, G, G, G) at world points (B, P, 3) of the box."""
    found = F.grid_sample(volume, points[:, :, None, None], padding_mode="border", align_corners=False)
    return found[..., 0, 0].transpose(1, 2)
