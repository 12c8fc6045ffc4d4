"""The blend of a back-projection (ARM, section 5.2): one colour a texel from what the views say of it."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from ..graphics.color import srgb_from_linear
from ..structures import TexelViews

BLEND_CHUNK = 1 << 17  # Texels blended at once; bounds the work space.


@dataclass(frozen=True)
class BlendConfig:
    """How views share a texel."""

    cosine_power: float = 4.0
    """Of n.v in a view's weight. 0 ghosts where views disagree; large values show seams between them."""
    disagreement: float = 0.1
    """Difference in sRGB at which, of three views and more, the weight of one falls to a quarter. Too small drops
    detail at random; too large keeps highlights and ghosts."""
    rounds: int = 3
    """Of finding what the views agree on. Fewer leave a strong outlier its pull."""
    reach: float = 1.0 / 128.0
    """Share of the texture's side over which views take turns. Without it what they show jumps from texel to texel, and
    patches with hard edges stand in every highlight; too large lets a neighbour's outlier through."""


@torch.no_grad()
def blend(seen: TexelViews, weights: Tensor, config: BlendConfig = BlendConfig()) -> tuple[Tensor, Tensor]:
    """One colour a texel: views weighted by the user, by how squarely they look, and by agreement with the others.

    Args:
        seen: V views of T x T texels.
        weights: (V,) >= 0, the user's.
    Returns:
        (3, T, T) linear colour and (T, T) total weight; both 0 where no view of positive weight sees the texel.
    Raises:
        ValueError: not one weight a view.
    """
    if weights.shape != seen.visibility.shape[:1]:
        raise ValueError(f"{len(seen.visibility)} views, weights {tuple(weights.shape)}")
    size = seen.visibility.shape[-1]
    color = seen.color.new_zeros(3, size * size)
    total = seen.color.new_zeros(size * size)
    standing = _standing(seen, weights, config).flatten(1)
    for texel in seen.seen.flatten().nonzero()[:, 0].split(BLEND_CHUNK):
        colors = seen.color.flatten(2)[:, :, texel]  # (V, 3, P)
        trusted = _trusted(seen, weights, texel)
        facing = seen.cosine.flatten(1)[:, texel] * (trusted > 0)
        # Over the squarest view's: a high power of a small cosine would leave nothing to divide by.
        best = facing.amax(dim=0).clamp(min=1e-6)
        share = trusted * (facing / best) ** config.cosine_power * standing[:, texel]
        color[:, texel] = (share[:, None] * colors).sum(dim=0) / share.sum(dim=0).clamp(min=1e-12)
        total[texel] = share.sum(dim=0) * best**config.cosine_power
    return color.view(3, size, size), total.view(size, size)


def _trusted(seen: TexelViews, weights: Tensor, texel: Tensor) -> Tensor:
    """(V, P) the user's weight of every view at texels (P,); 0 where it sees nothing."""
    return seen.visibility.flatten(1)[:, texel] * weights.to(seen.color)[:, None]


def _standing(seen: TexelViews, weights: Tensor, config: BlendConfig) -> Tensor:
    """(V, T, T) in [0, 1]: how far each view is to be followed at a texel; 0 where it sees nothing.

    How well it agrees with the rest in the mean around the texel, and less near the border of what it sees: where a
    view begins to see, it is hardly followed at first.
    """
    count, size = seen.visibility.shape[:2]
    vote = seen.color.new_zeros(count, size * size)
    for texel in seen.seen.flatten().nonzero()[:, 0].split(BLEND_CHUNK):
        trusted = _trusted(seen, weights, texel)
        vote[:, texel] = _vote(seen.color.flatten(2)[:, :, texel], trusted, config) * (trusted > 0)
    standing = vote.view(count, size, size)
    radius = round(config.reach * size)
    if not radius:
        return standing
    own = seen.visibility & (weights > 0).to(seen.visibility.device)[:, None, None]
    anyone = _around(own.any(dim=0).to(standing), radius).clamp(min=1e-6)
    for view, sees in enumerate(own):
        share = _around(sees.to(standing), radius).clamp(min=1e-6)
        # A half is a straight border. What a view alone sees it is believed in, however narrow.
        inside = (2.0 * share / anyone - 1.0).clamp(min=1e-3)
        standing[view] = sees * inside * _around(standing[view], radius) / share
    return standing


def _around(plane: Tensor, radius: int) -> Tensor:
    """(T, T) mean of `plane` around every texel: two boxes, one after the other, each along rows and columns."""
    side, plane = 2 * radius + 1, plane[None]
    for _ in range(2):
        plane = avg_pool2d(plane, (1, side), stride=1, padding=(0, radius))
        plane = avg_pool2d(plane, (side, 1), stride=1, padding=(radius, 0))
    return plane[0]


def _vote(colors: Tensor, trusted: Tensor, config: BlendConfig) -> Tensor:
    """(V, P) in (0, 1]: how well each view agrees with the rest; 1 where fewer than three see the texel.

    Iteratively reweighted mean with the Geman-McClure weight, started from the plain mean.
    """
    perceived = srgb_from_linear(colors)
    agreement = torch.ones_like(trusted)
    for _ in range(config.rounds):
        share = trusted * agreement
        center = (share[:, None] * perceived).sum(dim=0) / share.sum(dim=0).clamp(min=1e-12)
        difference = (perceived - center).abs().amax(dim=1) / config.disagreement
        agreement = (1.0 + difference**2) ** -2
    return torch.where((trusted > 0).sum(dim=0) >= 3, agreement, 1.0)
