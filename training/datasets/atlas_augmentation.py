"""More samples of InstantAlbedo out of each: the same object in other colours, turned about the vertical."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from arm_blender.structures import TexelMap

from .atlases import Atlas


def augmented(atlas: Atlas, random: torch.Generator) -> Atlas:
    """`augment` by chance."""
    angle = 2.0 * math.pi * float(torch.rand((), generator=random))
    return augment(atlas, torch.randperm(3, generator=random), angle)


def augment(atlas: Atlas, channels: Tensor, angle: float) -> Atlas:
    """The same object in other colours and turned about the vertical: its colours' channels permuted, its surface
    positions and directions rotated by `angle` radians. Truth and input change alike.

    Args:
        channels: permutation of (0, 1, 2).
    """
    c, s = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def turned(x: Tensor) -> Tensor:
        return torch.einsum("ij,...jhw->...ihw", turn, x)

    seen, texels = atlas.seen, atlas.texels
    return Atlas(
        images=atlas.images[:, [*channels.tolist(), 3]],
        texels=TexelMap(turned(texels.position), turned(texels.normal), texels.mask),
        seen=replace(seen, color=seen.color[:, channels], eyes=seen.eyes @ turn.T),
        base=atlas.base[channels],
        lookup=atlas.lookup,
        baked=atlas.baked[:, channels],
        albedo=atlas.albedo[:, channels],
    )
