"""One gain for each view and channel: a camera that exposes by itself changes them from picture to picture.

What several views see of a matt surface has one colour. The gains are those under which views agree on what they share
(as panoramas are evened out: Brown and Lowe, "Automatic panoramic image stitching", IJCV 2007, section 6), found in
logarithms, where they are a sum, and robustly, for highlights do move.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..report import Report
from ..structures import TexelViews, ViewSet


@dataclass(frozen=True)
class ExposureConfig:
    """How gains are found, and when they are believed."""

    texels: int = 20000
    """Looked at, at most."""
    darkest: float = 0.01
    """Linear value below which a channel is noise."""
    brightest: float = 0.95
    """Linear value above which it is clipped."""
    disagreement: float = 0.25
    """Difference of logarithms at which the weight of a texel in a view falls to a quarter."""
    rounds: int = 12
    """Of reweighting."""
    prior: float = 0.002
    """Of the texels, the share that speaks for no gain at all: a view that shares less with others keeps its own."""
    least: float = 0.02
    """Logarithm of a gain below which all are left alone: the eye does not see it."""


def even(views: ViewSet, seen: TexelViews, report: Report) -> tuple[ViewSet, TexelViews]:
    """The views of a camera that exposes by itself, and what they say of texels, as of one exposure."""
    factors = gains(seen)
    if bool((factors == 1.0).all()):
        report.leave_out("gains of the views", "the views are of one exposure")
        return views, seen
    report.gains = factors.tolist()
    return evened(views, seen, factors)


@torch.no_grad()
def gains(seen: TexelViews, config: ExposureConfig = ExposureConfig()) -> Tensor:
    """(V, 3) factors by which the views' linear colours agree with each other; all 1 where they do already.

    Their geometric mean over the views is 1, for how bright the whole is no view knows.

    Args:
        seen: of V views.
    """
    count = len(seen.visibility)
    none = seen.color.new_ones(count, 3)
    shared = (seen.visibility.sum(dim=0) > 1).flatten().nonzero()[:, 0]
    if not len(shared):
        return none
    # Evenly over the atlas, the same ones each time.
    shared = shared[:: -(-len(shared) // config.texels)]
    color = seen.color.flatten(2)[:, :, shared].permute(1, 0, 2)  # (3, V, P)
    usable = seen.visibility.flatten(1)[:, shared] & (color.amax(dim=0) < config.brightest)
    facing = seen.cosine.flatten(1)[:, shared] * usable
    logs = torch.stack([_log_gains(c, facing * (c > config.darkest), config) for c in color], dim=1)
    return none if float(logs.abs().max()) < config.least else logs.exp()


def _log_gains(color: Tensor, trusted: Tensor, config: ExposureConfig) -> Tensor:
    """(V,) logarithms of the factors of one channel's values (V, P), which count by `trusted` (V, P)."""
    logs = color.clamp(min=config.darkest).log().double()
    gain = logs.new_zeros(len(logs))
    weight = trusted.double()
    for _ in range(config.rounds):
        alone = (weight > 0.0).sum(dim=0) < 2
        own = torch.where(alone, 0.0, weight)
        total = own.sum(dim=0).clamp(min=1e-9)
        # Least squares in the gains, each texel's own colour eliminated; the prior leaves one solution.
        system = torch.diag(own.sum(dim=1) + config.prior * logs.shape[1]) - (own / total) @ own.T
        mean = (own * logs).sum(dim=0) / total
        gain = torch.linalg.solve(system, (own * (mean - logs)).sum(dim=1))
        gain = gain - gain.mean()
        moved = logs + gain[:, None]
        center = (own * moved).sum(dim=0) / total
        weight = trusted * (1.0 + ((moved - center) / config.disagreement) ** 2) ** -2
    return gain.to(color)


def evened(views: ViewSet, seen: TexelViews, factors: Tensor) -> tuple[ViewSet, TexelViews]:
    """The views, and what they say of texels, times (V, 3) factors; in [0, 1] as before."""
    factors = factors[:, :, None, None]
    images = torch.cat([(views.images[:, :3] * factors).clamp(max=1.0), views.images[:, 3:]], dim=1)
    return replace(views, images=images), replace(seen, color=(seen.color * factors).clamp(max=1.0))
