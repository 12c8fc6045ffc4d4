"""What the views of a surface show of its finish: numbers for each point, which need no network.

A glossy point changes with the view, most where the view mirrors a lamp; a metal's highlights have its own colour; what
is sharp in the pictures beside what is smooth tells stuff from stuff. Pictures may be black, white or burnt out: each
number is bounded.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from ...graphics.color import LUMINANCE, srgb_from_linear
from ...graphics.light.spherical_harmonics import COUNT, gathered
from ..atlas_cells import DARK
from .delighting import SeenPoints

SHARPNESS = (2.0, 8.0, 32.0, 128.0)
"""Of the lobes by which mirrored light is gathered, as of von Mises and Fisher: from matt to polished, each four times
that before."""

NEIGHBOURS = 32
"""Points around one that are its neighbourhood."""

REFERENCE = 2048
"""Sights at most that tell the mirrored light: more take time and change little."""

BURNT = 0.95
"""Linear. A channel as bright as this may have been brighter."""

OVER_VIEWS = (
    "spread", "brightest", "darkest", "skew", "grazing", "hue of change", "tint", "tint, weighed", "foreign hue",
    *(f"mirrored {sharpness:g}" for sharpness in SHARPNESS), *(f"reflected {sharpness:g}" for sharpness in SHARPNESS),
    *(f"explained {sharpness:g}" for sharpness in SHARPNESS), "spread around", "brightest around",
)  # fmt: skip
"""What it takes several views to see."""

OF_ONE_VIEW = (
    "seen", "burnt", "saturation", "lowest", "highest", "lit", "contrast around", "sharpness around", "hues around",
    "bends around", "light", "red", "green", "blue", "upwards", "height",
)  # fmt: skip
"""What one view shows as well."""

NAMES = OVER_VIEWS + OF_ONE_VIEW
"""Of the numbers of a point, in their order."""

_MOST = 20.0


@torch.no_grad()
def evidence(points: SeenPoints) -> Tensor:
    """(P, 39) numbers, as `NAMES` names them; of one object, B = 1.

    Raises:
        ValueError: it is not one object, or has no points.
    """
    if points.position.shape[0] != 1 or not points.position.shape[1]:
        raise ValueError(f"evidence is of the points of one object, not of {tuple(points.position.shape)}")
    sights = _Sights.of(points)
    around = _neighbours(points.position[0])
    found = [*_over_views(sights, around), *_alone(points, sights, around)]
    return torch.nan_to_num(torch.stack(found, dim=1)).clamp(-_MOST, _MOST)


@dataclass(frozen=True)
class _Sights:
    """What V views see of P points.

    Attributes:
        color: (V, P, 3) linear in [0, 1]. visible: (V, P) bool.
        weight: (V, P) of the views, who looks squarely counting a little more; of a point 1 in all.
        cosine: (V, P) n.v. mirrored: (V, P, 3) unit, where the light comes from that a mirror would show.
        blend: (P, 3) linear.
        level: (V, P) logarithm of luminance. change: (V, P) that less the blend's; 0 where a view does not see.
    """

    color: Tensor
    visible: Tensor
    weight: Tensor
    cosine: Tensor
    mirrored: Tensor
    blend: Tensor
    level: Tensor
    change: Tensor

    @classmethod
    def of(cls, points: SeenPoints) -> "_Sights":
        visible, normal, towards = points.visible[0], points.normal[0], points.towards()[0]
        color = torch.where(visible[..., None], points.color[0], 0.0).clamp(0.0, 1.0)
        facing = (towards * normal).sum(dim=-1)
        cosine = facing.clamp(min=0.02)
        weight = visible * cosine.sqrt()
        blend = points.blended()[0].clamp(0.0, 1.0)
        level = _level(color)
        return cls(
            color,
            visible,
            weight / weight.sum(dim=0).clamp(min=1e-9),
            cosine,
            2.0 * cosine[..., None] * normal - towards,
            blend,
            level,
            (level - _level(blend)) * visible,
        )

    def mean(self, x: Tensor) -> Tensor:
        """(P,) of numbers (V, P) over the views that see the point."""
        return (self.weight * x).sum(dim=0)


def _over_views(sights: _Sights, around: Tensor) -> list[Tensor]:
    """(P,) each, as `OVER_VIEWS` names them; `around` (P, K) are the neighbours."""
    change, visible, mean = sights.change, sights.visible, sights.mean
    usual = mean(change)
    off = change - usual
    spread = mean(off.square()).sqrt()
    brightest = change.masked_fill(~visible, -_MOST).amax(dim=0)
    darkest = change.masked_fill(~visible, _MOST).amin(dim=0)
    skew = mean(off**3) / (spread**3 + 1e-3)
    # Fresnel: at grazing angles everything mirrors.
    rise = (1.0 - sights.cosine) ** 2
    away = rise - mean(rise)
    grazing = mean(away * off) / (mean(away.square()) + 0.01)
    # What changes with the view is mirrored light. A metal dyes it, a varnish does not.
    which = torch.arange(change.shape[1], device=change.device)
    low = sights.color[sights.level.masked_fill(~visible, _MOST).argmin(dim=0), which]
    high = sights.color[sights.level.masked_fill(~visible, -_MOST).argmax(dim=0), which]
    own, changed = _hue(low), _hue((high - low).clamp(min=0.0))
    product = (own * changed).sum(dim=1)
    size = own.norm(dim=1) * changed.norm(dim=1)
    hues = [changed.norm(dim=1), product / (size + 0.02), 10.0 * product, (own - changed).norm(dim=1)]
    near = [spread[around].mean(dim=1), brightest[around].mean(dim=1)]
    return [spread, brightest, darkest, skew, grazing, *hues, *_mirroring(sights), *near]


def _mirroring(sights: _Sights) -> list[Tensor]:
    """(P,) each: for every sharpness how far a point repeats the mirrored light, how strongly, and what that explains.

    The mirrored light is what other points show that mirror the same direction, more or less sharply.
    """
    view, point = sights.visible.nonzero().unbind(dim=1)
    direction, change = sights.mirrored[view, point], sights.change[view, point]
    weight, cosine = sights.weight[view, point], sights.cosine[view, point]
    # As much as it is, beside how much it is of the whole: metals reflect most.
    luminance = (sights.color - sights.blend)[view, point] @ change.new_tensor(LUMINANCE)
    few = torch.linspace(0, len(view) - 1, min(len(view), REFERENCE), device=view.device).long()
    # A point is no witness for itself: its lobes are 0, whatever their power.
    lobe = ((direction @ direction[few].T - 1.0) * SHARPNESS[0]).exp_().mul_(point[:, None] != point[few])  # (S, R)
    sides = torch.stack([change, luminance, torch.ones_like(change)], dim=1)[few] * cosine[few, None]
    total = (weight * change.square()).sum() + 1e-3

    def summed(x: Tensor) -> Tensor:
        return x.new_zeros(sights.visible.shape[1]).index_add_(0, point, weight * x)

    repeated, reflected, explained = [], [], []
    for sharper in range(len(SHARPNESS)):
        if sharper:
            lobe.square_().square_()
        sent = lobe @ sides
        light, strength = (sent[:, :2] / (sent[:, 2:] + 0.3)).unbind(dim=1)
        reflected.append(100.0 * summed(strength * luminance))
        product = summed(light * change)
        repeated.append(product / (summed(light.square()) + 0.003))
        explained.append((product.sum() / total).expand_as(product))
    return [*repeated, *reflected, *explained]


def _alone(points: SeenPoints, sights: _Sights, around: Tensor) -> list[Tensor]:
    """(P,) each, as `OF_ONE_VIEW` names them."""
    visible, blend, level = sights.visible, sights.blend, _level(sights.blend)
    hue, shown, normal = _hue(blend), srgb_from_linear(blend), points.normal[0]
    luminance = srgb_from_linear(sights.color) @ shown.new_tensor(LUMINANCE)
    lowest = luminance.masked_fill(~visible, _MOST).amin(dim=0)
    burnt = sights.mean((sights.color.amax(dim=2) > BURNT).float())
    return [
        visible.float().mean(dim=0),
        burnt,
        hue.norm(dim=1),
        lowest,
        luminance.masked_fill(~visible, 0.0).amax(dim=0),
        level - _lit_if_white(normal, blend),
        level[around].std(dim=1, correction=0),
        _sharpness(sights, around),
        hue[around].std(dim=1, correction=0).norm(dim=1),
        (normal[around] - normal[:, None]).norm(dim=2).mean(dim=1),
        level,
        *shown.unbind(dim=1),
        normal[:, 2],
        points.position[0, :, 2],
    ]


def _lit_if_white(normal: Tensor, blend: Tensor) -> Tensor:
    """(P,) logarithm of the luminance that smooth light gives to normals (P, 3), all of one white."""
    basis = gathered(normal)
    square = basis.T @ basis / len(basis) + 0.003 * torch.eye(COUNT, device=basis.device)
    luminance = blend @ blend.new_tensor(LUMINANCE)
    light = torch.linalg.solve(square, basis.T @ luminance / len(basis))
    return ((basis @ light).clamp(min=DARK) + DARK).log()


def _sharpness(sights: _Sights, around: Tensor) -> Tensor:
    """(P,) deviation of single views' luminance around a point: what blending views would smooth away."""
    seen, level = sights.visible[:, around].float(), sights.level[:, around]  # (V, P, K)
    count = seen.sum(dim=2).clamp(min=1.0)
    mean = (seen * level).sum(dim=2) / count
    variance = (seen * (level - mean[..., None]).square()).sum(dim=2) / count
    return sights.mean(variance.sqrt())


def _neighbours(position: Tensor) -> Tensor:
    """(P, K) indices of the `NEIGHBOURS` nearest others of points (P, 3); of a lone one itself."""
    count = len(position)
    if count == 1:
        return torch.zeros(1, 1, dtype=torch.int64, device=position.device)
    nearest = torch.cdist(position, position).topk(min(NEIGHBOURS + 1, count), largest=False).indices
    return nearest[:, 1:]


def _level(color: Tensor) -> Tensor:
    """(...) logarithm of the luminance of linear colours (..., 3), of black not too low."""
    return (color @ color.new_tensor(LUMINANCE) + DARK).log()


def _hue(color: Tensor) -> Tensor:
    """(..., 3) share of each channel, less that of grey."""
    color = color + DARK
    return functional.normalize(color, p=1.0, dim=-1) - 1.0 / 3.0
