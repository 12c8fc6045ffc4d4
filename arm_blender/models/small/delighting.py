"""Delighting: what light the views were taken under, and which albedo is left without it.

Not in the paper, whose InstantAlbedo has to find the light by itself. Charts tear apart in an atlas what the light ties
together: all that faces the sky is lit alike, wherever it lies. Here the surface is a set of points without an order.
A few learned tokens read it (Jaegle et al., "Perceiver IO", https://arxiv.org/abs/2107.14795) and tell the light as
spherical harmonics, whose irradiance is divided out; then every point asks the tokens how far that was wrong where it
lies: in a shadow, in a highlight, on a metal.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...graphics.cameras import directions_to
from ...graphics.color import srgb_from_linear
from ...graphics.light.spherical_harmonics import COUNT, WHITE, gathered
from ..atlas_cells import DARK, log_gain

DARKEST = 0.02
"""Least irradiance over pi that a colour is divided by."""

REFLECTED = 0.04
"""Share of the light that a dielectric reflects without taking on its colour."""

SQUARELY = 4.0
"""Power of n.v in a view's weight, as in the blend."""

READ = 4096
"""Points that the light is read from: more take time and change nothing."""

TRUSTED = 0.8
"""Share of a point's own correction that is taken. On held-out rigs 0, 0.3, 0.6, 0.8 and 1 give albedo of 17.0, 17.6,
18.1, 18.3 and 18.4 dB, and on the rendered ones among them 18.2, 18.6, 18.8, 18.9 and 19.0; the views' blend has 15.6
and 17.4. What is left is a reserve: those are four objects."""

_VIEW_CHANNELS, _POINT_CHANNELS = 13, 12 + COUNT
_MOST = 1.5
"""Bound on the logarithm of a point's own correction."""


@dataclass(frozen=True)
class DelightingConfig:
    """Sizes of the network."""

    width: int = 96
    """Channels of a token."""
    view_width: int = 32
    """Channels of what one view says of a point."""
    tokens: int = 32
    """That read the surface. More know more lights apart, and cost little."""
    heads: int = 4
    """Of an attention."""
    depth: int = 2
    """Blocks among the tokens after each of two readings."""


@dataclass(frozen=True)
class SeenPoints:
    """What V views say of P points of a surface, each of which one of them sees.

    Attributes:
        position: (B, P, 3) world, in the box. normal: (B, P, 3) unit.
        color: (B, V, P, 3) linear in [0, 1]; where a view does not see a point it means nothing.
        visible: (B, V, P) bool.
        eyes: (B, V, 3) where the cameras are, world.
    """

    position: Tensor
    normal: Tensor
    color: Tensor
    visible: Tensor
    eyes: Tensor

    def blended(self) -> Tensor:
        """(B, P, 3) linear colour: the views' mean, who looks squarely counting most; 0 where none sees the point."""
        cosine = (self.towards() * self.normal[:, None]).sum(dim=-1).clamp(min=0.0)
        weight = (self.visible * cosine**SQUARELY).unsqueeze(-1)
        return (weight * self.color).sum(dim=1) / weight.sum(dim=1).clamp(min=1e-6)

    def towards(self) -> Tensor:
        """(B, V, P, 3) unit, from the points to the cameras."""
        return directions_to(self.eyes[:, :, None], self.position[:, None])

    def only(self, points: Tensor) -> "SeenPoints":
        """Some of the points: their indices."""
        position, normal = self.position[:, points], self.normal[:, points]
        return SeenPoints(position, normal, self.color[:, :, points], self.visible[:, :, points], self.eyes)


@dataclass(frozen=True)
class Delit:
    """What is left without the light.

    Attributes:
        color: (B, P, 3) linear, the views' blend, from which the light was taken.
        light: (B, 9, 3) coefficients, as of `spherical_harmonics.gathered`.
        even: (B, P, 3) linear albedo by that light alone.
        albedo: (B, P, 3) linear, corrected point by point.
    """

    color: Tensor
    light: Tensor
    even: Tensor
    albedo: Tensor


class Delighting(nn.Module):
    """Points to light and albedo."""

    def __init__(self, config: DelightingConfig) -> None:
        super().__init__()
        self.config = config
        width, own = config.width, config.view_width
        self.view = nn.Sequential(nn.Linear(_VIEW_CHANNELS, own), nn.GELU(), nn.Linear(own, own), nn.GELU())
        self.point = nn.Sequential(
            nn.Linear(_POINT_CHANNELS + 2 * own + 1, width), nn.GELU(), nn.Linear(width, width), nn.GELU(),
            nn.Linear(width, width),
        )  # fmt: skip
        self.tokens = nn.Parameter(torch.empty(config.tokens, width))
        nn.init.normal_(self.tokens, std=0.1)
        self.guess = nn.Sequential(nn.Linear(6 * COUNT, width), nn.GELU(), nn.Linear(width, width))
        self.readings = nn.ModuleList(_Block(config, crossed=True) for _ in range(2))
        self.blocks = nn.ModuleList(
            nn.ModuleList(_Block(config) for _ in range(config.depth)) for _ in range(2)
        )  # fmt: skip
        self.light = nn.Linear(width, 3 * COUNT)
        self.asking = _Block(config, crossed=True)
        self.correction = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.GELU(), nn.Linear(width, 3))
        for last in (self.light, self.correction[-1]):
            for parameter in last.parameters():
                nn.init.zeros_(parameter)

    def forward(self, points: SeenPoints, read: Tensor | None = None) -> Delit:
        """Light and albedo.

        Args:
            points: P of them, at least one.
            read: indices of those that the light is read from; all for None. A few thousand tell it.
        """
        color = points.blended()
        basis = gathered(points.normal)
        told = self._told(points, color, basis)
        few = slice(None) if read is None else read
        tokens = self.tokens + self.guess(_if_white(basis[:, few], color[:, few]))[:, None]
        for reading, blocks in zip(self.readings, self.blocks, strict=True):
            tokens = reading(tokens, told[:, few])
            assert isinstance(blocks, nn.ModuleList)
            for block in blocks:
                tokens = block(tokens)
        light = 0.5 * self.light(tokens.mean(dim=1)).unflatten(-1, (COUNT, 3))
        light = light + WHITE * F.one_hot(light.new_zeros(1, dtype=torch.int64), COUNT).T
        irradiance = F.softplus(5.0 * (basis @ light)) / 5.0 + DARKEST
        even = color / irradiance
        # A bright albedo loses what is reflected, a dark one a share of itself, and none becomes negative.
        even = even.square() / (even + REFLECTED)
        gain = self.correction(self.asking(told, tokens))
        gain = torch.expm1(_MOST * torch.tanh(gain / _MOST))
        return Delit(color, light, even, even + (even + DARK) * gain)

    def log_gain(self, points: SeenPoints) -> tuple[Tensor, Tensor]:
        """(P, 3) logarithm of albedo over the views' blend, as `atlas_cells.scaled` takes it; of one object, B = 1.

        And (9, 3), the light, as of `Delit`.
        """
        count = points.position.shape[1]
        read = torch.linspace(0, count - 1, min(count, READ), device=points.position.device).long()
        found = self(points, read)
        even, albedo = found.even.clamp(0.0, 1.0), found.albedo.clamp(0.0, 1.0)
        return (log_gain(even, found.color) + TRUSTED * log_gain(albedo, even))[0], found.light[0]

    def _told(self, points: SeenPoints, color: Tensor, basis: Tensor) -> Tensor:
        """(B, P, W) what is known of each point, of whose normal `basis` (B, P, 9) is what it gathers."""
        towards = points.towards()
        cosine = (towards * points.normal[:, None]).sum(dim=-1, keepdim=True).clamp(min=0.0)
        mirrored = 2.0 * cosine * points.normal[:, None] - towards
        seen, blended = srgb_from_linear(points.color), srgb_from_linear(color)
        said = self.view(torch.cat([seen - blended[:, None], seen, cosine, towards, mirrored], dim=-1))
        visible = points.visible.unsqueeze(-1)
        count = visible.sum(dim=1)
        pooled = [
            (said * visible).sum(dim=1) / count.clamp(min=1),
            said.masked_fill(~visible, -10.0).amax(dim=1),
            count / 3.0,
        ]
        own = [points.normal, points.position, blended, (color + DARK).log(), basis]
        return self.point(torch.cat(own + pooled, dim=-1))


class _Block(nn.Module):
    """Attention to others, or among themselves, and an MLP; pre-normed and residual."""

    def __init__(self, config: DelightingConfig, crossed: bool = False) -> None:
        super().__init__()
        width = config.width
        self.norm = nn.LayerNorm(width)
        self.others = nn.LayerNorm(width) if crossed else None
        self.attention = nn.MultiheadAttention(width, config.heads, batch_first=True)
        self.mlp = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width)
        )  # fmt: skip

    def forward(self, x: Tensor, others: Tensor | None = None) -> Tensor:
        query = self.norm(x)
        key = query if others is None or self.others is None else self.others(others)
        x = x + self.attention(query, key, key, need_weights=False)[0]
        return x + self.mlp(x)


def _if_white(basis: Tensor, color: Tensor) -> Tensor:
    """(B, 54): the lights that fit colours (B, P, 3), and their logarithms, best were the surface white.

    What light they show together with the albedo; ridge regression on `basis` (B, P, 9).
    """
    count = basis.shape[1]
    square = basis.mT @ basis / count + 0.003 * torch.eye(COUNT, device=basis.device)
    sides = torch.cat([color, 0.3 * (color + DARK).log()], dim=-1)
    fitted = torch.linalg.solve(square, basis.mT @ sides / count)  # (B, 9, 6)
    return torch.cat([part.flatten(1) for part in fitted.split(3, dim=-1)], dim=1)
