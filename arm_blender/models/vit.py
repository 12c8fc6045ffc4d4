"""A plain vision transformer in the layout of DINO (Caron et al. 2021, arXiv 2104.14294).

Keys are those of its published ViTs (`blocks.i.norm1`, `attn.qkv`, `mlp.fc1`, ...), so that theirs load unmapped.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional


@dataclass(frozen=True)
class VitConfig:
    """DINO's ViT-B/8, as published."""

    patch: int = 8
    """Pixels a side of one token."""
    dim: int = 768
    """Width of a token."""
    depth: int = 12
    """Number of blocks."""
    heads: int = 12
    """Attention heads; divides `dim`."""
    mlp_ratio: int = 4
    """Hidden width of the MLP over `dim`."""
    grid: int = 28
    """Tokens a side that the position embedding was trained for; other sizes interpolate it."""


class Attention(nn.Module):
    """Multi-head self-attention over (B, L, D)."""

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(dim, 3 * dim)
        self.proj = nn.Linear(dim, dim)

    def forward(self, x: Tensor) -> Tensor:
        q, k, v = self.qkv(x).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)  # each (B, heads, L, D / heads)
        attended = functional.scaled_dot_product_attention(q, k, v)
        return self.proj(attended.transpose(1, 2).flatten(2))


class Mlp(nn.Module):
    """Two linear layers with a GELU between."""

    def __init__(self, dim: int, hidden: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(dim, hidden)
        self.fc2 = nn.Linear(hidden, dim)

    def forward(self, x: Tensor) -> Tensor:
        return self.fc2(functional.gelu(self.fc1(x)))


class Block(nn.Module):
    """Pre-norm attention and MLP, both residual."""

    def __init__(self, dim: int, heads: int, mlp_ratio: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(dim, eps=1e-6)
        self.attn = Attention(dim, heads)
        self.norm2 = nn.LayerNorm(dim, eps=1e-6)
        self.mlp = Mlp(dim, mlp_ratio * dim)

    def forward(self, x: Tensor) -> Tensor:
        x = x + self.attn(self.norm1(x))
        return x + self.mlp(self.norm2(x))


class PatchEmbed(nn.Module):
    """One token per patch; a module of its own because of its key, `patch_embed.proj`."""

    def __init__(self, patch: int, dim: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, dim, patch, stride=patch)

    def forward(self, images: Tensor) -> Tensor:
        return self.proj(images)


class VisionTransformer(nn.Module):
    """Tokens of normalised images, tapped after chosen blocks."""

    def __init__(self, config: VitConfig) -> None:
        super().__init__()
        self.config = config
        self.cls_token = nn.Parameter(torch.zeros(1, 1, config.dim))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + config.grid**2, config.dim))
        self.patch_embed = PatchEmbed(config.patch, config.dim)
        self.blocks = nn.ModuleList(Block(config.dim, config.heads, config.mlp_ratio) for _ in range(config.depth))
        nn.init.trunc_normal_(self.cls_token, std=0.02)
        nn.init.trunc_normal_(self.pos_embed, std=0.02)

    def embed(self, images: Tensor) -> Tensor:
        """(B, 1 + rows * columns, D) tokens before the first block.

        Args:
            images: (B, 3, H, W), normalised; H and W multiples of the patch.
        Raises:
            ValueError: the size is no multiple of the patch.
        """
        height, width = images.shape[-2:]
        patch = self.config.patch
        if height % patch or width % patch:
            raise ValueError(f"image size must be a multiple of {patch}, got {height} x {width}")
        tokens = self.patch_embed(images).flatten(2).transpose(1, 2)
        tokens = torch.cat([self.cls_token.expand(len(tokens), -1, -1), tokens], dim=1)
        return tokens + resampled_position(self.pos_embed, height // patch, width // patch)

    def forward(self, images: Tensor, taps: tuple[int, ...]) -> list[Tensor]:
        """Tokens (B, 1 + rows * columns, D), CLS first and unnormalised, after each of the blocks `taps`.

        Blocks behind the last tap are not run.
        """
        tokens = self.embed(images)
        outputs = {}
        for index, block in enumerate(self.blocks[: max(taps) + 1]):
            tokens = block(tokens)
            outputs[index] = tokens
        return [outputs[tap] for tap in taps]


def resampled_position(position: Tensor, rows: int, columns: int) -> Tensor:
    """A position embedding (1, 1 + grid**2, D), CLS first, for a grid of other size: (1, 1 + rows * columns, D)."""
    grid = math.isqrt(position.shape[1] - 1)
    if (rows, columns) == (grid, grid):
        return position
    patches = position[:, 1:].unflatten(1, (grid, grid)).permute(0, 3, 1, 2)  # (1, D, grid, grid)
    # DINO scales by (n + 0.1) / grid, not to a size: sampling positions differ, and published weights expect it.
    scale = ((rows + 0.1) / grid, (columns + 0.1) / grid)
    patches = functional.interpolate(patches, scale_factor=scale, mode="bicubic")
    return torch.cat([position[:, :1], patches.flatten(2).transpose(1, 2)], dim=1)
