"""Whether views tell of one object: each mask against the hull of the others.

A picture that stands for another, a wrong pose, or a mask of something else leaves parts of a mask that no point of the
others' hull explains.
"""

from collections.abc import Iterable
from itertools import combinations

import torch
from torch import Tensor

from ..errors import CameraError
from ..structures import ViewSet
from .scene_frame import COARSE, normalise, points_in_box, silhouettes_of

AGREE = 0.9
"""Of the mask of every view, how much the hull of the others has to explain. Measured in docs/robustness.md."""

_RESTORED = 0.97
"""Of the masks, how much the hulls of the others explain once the views that are to blame are left out."""

_RAYS = 160
"""Pixels of a mask that are looked at."""

_IN_BOX = 0.97
"""Of the rays through each mask, how many have to cross [-1, 1]^3 for the object to lie there."""

_BLAMED = 2
"""Views that may be to blame together: two pictures that were exchanged."""

_FEWEST = 3
"""Views that have to be left when others are blamed; two agree too easily."""


@torch.no_grad()
def agreement(views: ViewSet) -> Tensor:
    """(V,) in [0, 1]: of each view's mask, how much the hull of the others explains. 0 where the masks meet nowhere."""
    inside = _inside(views)
    everyone = range(len(views.cameras))
    return torch.zeros(len(views.cameras)) if inside is None else _explained(inside, everyone)


@torch.no_grad()
def disagreement(views: ViewSet, names: Iterable[str]) -> str | None:
    """Why the views cannot all be of one object, in words that name the pictures to blame; None where they can.

    Args:
        views: at least two; of fewer nothing can be said.
        names: of their pictures.
    """
    count, named = len(views.cameras), list(names)
    if count < 2:
        return None
    inside = _inside(views)
    if inside is None:
        return None  # The masks meet nowhere: the pipeline says so.
    explained = _explained(inside, range(count))
    if float(explained.min()) >= AGREE:
        return None
    share = f"the others explain {float(explained.min()):.0%} of the mask of {named[int(explained.argmin())]}"
    for size in range(1, _BLAMED + 1):
        best: float = 0.0
        blamed: tuple[int, ...] = ()
        for without in combinations(range(count), size) if count - size >= _FEWEST else ():
            rest = [view for view in range(count) if view not in without]
            best, blamed = max((best, blamed), (float(_explained(inside, rest).min()), without))
        if best >= _RESTORED:
            who = " and ".join(named[index] for index in blamed)
            does = "does" if size == 1 else "do"
            return f"{who} {does} not fit the other pictures ({share}); check its mask and its camera, or leave it out"
    return f"the pictures do not agree on one object ({share}); check cameras, their order, and masks"


def _inside(views: ViewSet) -> list[Tensor] | None:
    """Of each view (V, R, S) bool: which views hold the samples of the rays through its mask."""
    silhouettes = silhouettes_of(views, COARSE)
    rays = [points_in_box(silhouette, _RAYS) for silhouette in silhouettes]
    if min(float(crosses.float().mean()) for _, crosses in rays) < _IN_BOX:
        # The scene is elsewhere. Of one in the box no view that is wrong shall say where it is.
        try:
            silhouettes = silhouettes_of(normalise(views)[0], COARSE)
        except CameraError:
            return None
        rays = [points_in_box(silhouette, _RAYS) for silhouette in silhouettes]
    found = []
    for points, crosses in rays:
        held = torch.stack([other.holds(points.view(-1, 3)) for other in silhouettes])
        found.append(held.view(len(silhouettes), *points.shape[:2]) & crosses[:, None])
    return found


def _explained(inside: list[Tensor], views: Iterable[int]) -> Tensor:
    """(n,) of each of the `views`, how many of its rays meet the hull of all of them."""
    chosen = list(views)
    return torch.stack([inside[view][chosen].all(dim=0).any(dim=1).float().mean() for view in chosen])
