"""The image encoder: a DINO ViT whose layers are modulated by the camera (ARM, supplement; Instant3D, section 3.2).

ViT: https://arxiv.org/abs/2010.11929, DINO: https://arxiv.org/abs/2104.14294, Instant3D: https://arxiv.org/abs/2311.06214.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .vit import Attention, resampled_position

CAMERA_VALUES = 16


@dataclass(frozen=True)
class ImageEncoderConfig:
    """The paper's encoder: DINO's ViT-B/16 at 320 pixels."""

    image_size: int = 320
    """Pixels a side that views are resized to; unstated in the paper, 320 is what Zero123++ draws."""
    patch_size: int = 16
    """Pixels a side of a token; unstated in the paper (its ViT-B/8 is the material's), 16 is InstantMesh's."""
    position_grid: int = 14
    """Tokens a side of the stored position embedding; interpolated to the image's grid. 14 is DINO's (224 / 16)."""
    width: int = 768
    """Channels of a token (paper: 768)."""
    depth: int = 12
    """Layers; ViT-B has 12, and an MLP four times as wide as a token."""
    heads: int = 12
    """Attention heads; ViT-B has 12."""
    mean: tuple[float, float, float] = (0.485, 0.456, 0.406)
    """Of the images that the encoder was trained on, sRGB. The wrong one shifts every token; checkpoints carry it."""
    std: tuple[float, float, float] = (0.229, 0.224, 0.225)
    """As `mean`."""


def camera_embedding(c2w: Tensor, K: Tensor, size: int) -> Tensor:
    """The 16 numbers that describe a camera (reference: InstantMesh): c2w[:3, :4] row-major, then fx, fy, cx, cy.

    Args:
        c2w: (..., 4, 4).
        K: (..., 3, 3) pixels of an image of `size` pixels a side.
    Returns:
        (..., 16), intrinsics divided by `size`.
    """
    extrinsics = c2w[..., :3, :].flatten(-2)
    intrinsics = torch.stack([K[..., 0, 0], K[..., 1, 1], K[..., 0, 2], K[..., 1, 2]], dim=-1) / size
    return torch.cat([extrinsics, intrinsics], dim=-1)


class ModulatedBlock(nn.Module):
    """A pre-norm transformer layer; the camera shifts and scales both of its norms. No gates (Instant3D)."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        # HF's ViT layers have eps 1e-12, unlike timm's 1e-6.
        self.norm1 = nn.LayerNorm(width, eps=1e-12)
        self.attn = Attention(width, heads)
        self.norm2 = nn.LayerNorm(width, eps=1e-12)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))
        self.modulation = nn.Sequential(nn.SiLU(), nn.Linear(width, 4 * width))
        # Zero: an encoder that has never seen a camera starts as the plain ViT.
        for parameter in self.modulation.parameters():
            nn.init.zeros_(parameter)

    def forward(self, x: Tensor, camera: Tensor) -> Tensor:
        """(B, L, D) tokens under a camera embedded to (B, D)."""
        shift1, scale1, shift2, scale2 = self.modulation(camera).unsqueeze(1).chunk(4, dim=-1)
        x = x + self.attn(self.norm1(x) * (1.0 + scale1) + shift1)
        return x + self.mlp(self.norm2(x) * (1.0 + scale2) + shift2)


class ImageEncoder(nn.Module):
    """Pose-aware tokens of each view."""

    mean: Tensor
    std: Tensor

    def __init__(self, config: ImageEncoderConfig) -> None:
        super().__init__()
        self.config = config
        self.patch_embed = nn.Conv2d(3, config.width, config.patch_size, stride=config.patch_size)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, config.width))
        self.position = nn.Parameter(torch.empty(1, 1 + config.position_grid**2, config.width))
        nn.init.normal_(self.position, std=0.02)
        self.camera_embedder = nn.Sequential(
            nn.Linear(CAMERA_VALUES, config.width), nn.SiLU(), nn.Linear(config.width, config.width)
        )
        self.blocks = nn.ModuleList(ModulatedBlock(config.width, config.heads) for _ in range(config.depth))
        self.norm = nn.LayerNorm(config.width, eps=1e-12)
        # Of the configuration, not of the weights: there even in a module that is built without memory.
        for name, values in (("mean", config.mean), ("std", config.std)):
            self.register_buffer(name, torch.tensor(values, device="cpu").view(1, 3, 1, 1), persistent=False)

    def forward(self, images: Tensor, cameras: Tensor) -> Tensor:
        """Tokens of views, each under its camera.

        Args:
            images: (B, 3, H, W) sRGB in [0, 1], composited on the background that the encoder knows.
            cameras: (B, 16), see `camera_embedding`.
        Returns:
            (B, 1 + H/patch * W/patch, D) tokens, CLS first.
        """
        x = self.patch_embed((images - self.mean) / self.std)
        rows, columns = x.shape[-2:]
        x = x.flatten(2).transpose(1, 2)
        x = torch.cat([self.cls_token.expand(x.shape[0], -1, -1), x], dim=1)
        x = x + resampled_position(self.position, rows, columns)
        camera = self.camera_embedder(cameras)
        for block in self.blocks:
            x = block(x, camera)
        return self.norm(x)
