"""The triplane transformer: learned plane tokens attend to the tokens of all views (LRM, https://arxiv.org/abs/2311.04400)."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F


@dataclass(frozen=True)
class TransformerConfig:
    """The paper's transformer (table 4).

    What the table leaves out is InstantMesh's: cross-attention before self-attention, no biases in either, an MLP four
    times as wide with GELU, norms before each.
    """

    width: int = 1024
    """Channels of a plane token (paper: 1024)."""
    layers: int = 16
    """Paper: 16."""
    heads: int = 16
    """Paper: 16."""
    grid: int = 32
    """Tokens a side of one plane (paper: coarse triplane resolution 32)."""


class CrossAttention(nn.Module):
    """Queries from the planes, keys and values from the views; no biases."""

    def __init__(self, width: int, context_width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.q = nn.Linear(width, width, bias=False)
        self.k = nn.Linear(context_width, width, bias=False)
        self.v = nn.Linear(context_width, width, bias=False)
        self.out = nn.Linear(width, width, bias=False)

    def split(self, x: Tensor) -> Tensor:
        """(B, L, D) by heads: (B, heads, L, D / heads)."""
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        y = F.scaled_dot_product_attention(
            self.split(self.q(x)), self.split(self.k(context)), self.split(self.v(context))
        )
        return self.out(y.transpose(1, 2).flatten(-2))


class TransformerBlock(nn.Module):
    """Cross-attention, self-attention, MLP; each pre-normed and residual."""

    def __init__(self, config: TransformerConfig, context_width: int) -> None:
        super().__init__()
        width = config.width
        self.norm1, self.norm2, self.norm3 = (nn.LayerNorm(width, eps=1e-5) for _ in range(3))
        self.cross_attn = CrossAttention(width, context_width, config.heads)
        self.self_attn = CrossAttention(width, width, config.heads)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        x = x + self.cross_attn(self.norm1(x), context)
        normed = self.norm2(x)
        x = x + self.self_attn(normed, normed)
        return x + self.mlp(self.norm3(x))


class TriplaneTransformer(nn.Module):
    """(B, 3, D, R, R) coarse planes from the tokens of all views."""

    def __init__(self, config: TransformerConfig, context_width: int) -> None:
        super().__init__()
        self.config = config
        self.position = nn.Parameter(torch.empty(1, 3 * config.grid**2, config.width))
        nn.init.normal_(self.position, std=config.width**-0.5)
        self.layers = nn.ModuleList(TransformerBlock(config, context_width) for _ in range(config.layers))
        self.norm = nn.LayerNorm(config.width, eps=1e-6)

    def forward(self, context: Tensor, start: Tensor | None = None) -> Tensor:
        """Coarse planes of objects.

        Args:
            context: (B, L, context width) tokens of all views of an object.
            start: (B, 3 * R * R, D) added to the learned tokens: geometry to start from, if there is any.
        Returns:
            (B, 3, D, R, R).
        """
        x = self.position.expand(context.shape[0], -1, -1)
        if start is not None:
            x = x + start
        for layer in self.layers:
            x = layer(x, context)
        grid = self.config.grid
        return self.norm(x).reshape(-1, 3, grid, grid, self.config.width).permute(0, 1, 4, 2, 3)
