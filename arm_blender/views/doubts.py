"""Why an asset of some views may be wrong, as far as the views themselves tell."""

from collections.abc import Iterator, Sequence

import torch

from ..graphics.borders import cut_sides
from ..structures import UvMesh, ViewSet
from .agreement import disagreement
from .masks import parts
from .mesh_fit import outline_fit

_CUT_SHARE = 0.5
"""Of the views, how many have to be cut by their border: where fewer are, the others show what is beyond."""

_LEAST_FIT = 0.75
"""Intersection over union of a shape's outlines with the masks; of the objects of the evaluation it is 0.93."""

_ALL_AROUND, _SEEN = 4, 0.5
"""So many views see half of a surface and more, if they agree where it is."""

_RIVAL_SHARE = 0.4
"""Of the largest part's pixels, how many the second one has to have in every view to be a body of its own."""


def doubts(views: ViewSet) -> Iterator[str]:
    """A sentence for each reason, with what to do; of the views that count."""
    chosen = views.chosen()
    if not len(chosen.cameras):
        return
    names = chosen.called
    masks = chosen.images[:, 3].cpu()
    cut = [
        name
        for name, mask, known in zip(names, masks, chosen.rectangles, strict=True)
        if sum(cut_sides(mask, known)) > 0
    ]
    if len(cut) >= _CUT_SHARE * len(names):
        line = f"the border cuts the object in {len(cut)} of {len(names)} pictures ({_some(cut)})"
        yield f"{line}: what lies beyond is a guess; take them from further away"
    if all(_has_rival(mask) for mask in masks):
        yield "every picture shows several parts of about one size; if they are several objects, leave one in the masks"
    why = disagreement(chosen, names)
    if why is not None:
        yield why


def hardly_seen(share: float, count: int) -> Iterator[str]:
    """As `doubts`, where `count` views see but a small share of the surface that was made of them."""
    if count >= _ALL_AROUND and share < _SEEN:
        yield f"{count} views see {share:.0%} of the surface; check whether their masks and cameras fit together"


def misfit(mesh: UvMesh, views: ViewSet) -> Iterator[str]:
    """A sentence where the outlines of a shape that was made of `views`, in their frame, are not those of the masks."""
    if (fit := outline_fit(mesh, views)) < _LEAST_FIT:
        yield f"the shape fits the masks to {fit:.2f} only; check whether masks and cameras are of one object"


def _has_rival(mask: torch.Tensor) -> bool:
    """Whether the second part of `mask` (H, W) is nearly as large as the first."""
    step = max(1, max(mask.shape) // 512)
    areas = torch.bincount(parts(mask[::step, ::step] > 0.5).flatten())[1:].sort(descending=True).values
    return len(areas) > 1 and int(areas[1]) > _RIVAL_SHARE * int(areas[0])


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"{', '.join(names[:3])}{more}"
