"""A second look for what of the pictures is the object, once the cameras are known: by all pictures together."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

from ...models.small.cutout import Cutout, CutoutConfig
from ...progress import Progress, silent
from ...views.cutout import along_edges, load_cutout
from ...views.foreground import WAYS
from ...weight_files import checkpoints
from .evidence import CHANNELS, Scene, evidence, scene, window
from .eyes import Eye

WEIGHTS = "small.joint_cutout"
"""The name under which the network is registered."""

TOGETHER = "all pictures together"
"""The way of a mask that was found by this; the others are in `views.foreground.WAYS`."""

CONFIG = CutoutConfig(
    widths=(16, 24, 48, 96), depths=(0, 1, 1, 1), attention_layers=1, closer_side=192, evidence=CHANNELS
)
"""Less than the first look has: most of what it has to know is told to it."""

LOOKED_AT = 384
"""Pixels of the longer side of the pictures that evidence is gathered from."""

_CERTAIN = 0.982
"""Probability that is called certain."""

_NOTHING = -20.0
"""Logit outside of what is looked at."""


def is_guessed(way: str) -> bool:
    """Whether nobody gave a mask that was come by in this way."""
    return way in WAYS or way == TOGETHER


def logit_of(alpha: Tensor) -> Tensor:
    """How sure a mask is, of its alpha in [0, 1]."""
    return torch.logit(alpha.clamp(1.0 - _CERTAIN, _CERTAIN))


def joint_masks(
    picture: Callable[[int], Tensor],
    alphas: Sequence[Tensor | None],
    eyes: Sequence[Eye],
    ground: float | None,
    progress: Progress = silent,
) -> list[Tensor] | None:
    """The object's alpha in every picture.

    Args:
        picture: gives the (3, H, W) sRGB of a picture by its number; asked for twice.
        alphas: (H, W) each, what a first look found; None where it found nothing.
        eyes: the cameras; the object lies about the origin, its longest side about 2, Z is up.
        ground: height (Z) of what the object stands on; None where nobody knows.
        progress: is told each picture.
    Returns:
        (H, W) each; None where the network is not installed.
    Raises:
        CheckpointError: its weights are damaged.
    """
    path = checkpoints.shipped(WEIGHTS)
    if not path.is_file():
        return None
    network = load_cutout(path, path.stat().st_mtime_ns)
    pictures, logits = [], []
    for view, alpha in enumerate(alphas):
        progress(0.3 * view / len(alphas), "putting the pictures together")
        small = _reduced(picture(view))
        pictures.append(small)
        # What no mask was found of tells nothing.
        logits.append(torch.zeros(small.shape[1:]) if alpha is None else logit_of(_reduced(alpha[None])[0]))
    seen = scene(pictures, logits, eyes, ground)
    found = []
    for view in range(len(alphas)):
        progress(0.4 + 0.6 * view / len(alphas), "looking at all pictures together")
        found.append(along_edges(picture(view), _look(network, seen, view).sigmoid()))
    return found


def _look(network: Cutout, seen: Scene, view: int) -> Tensor:
    """(h, w) logits of a picture; the mean with its mirror image's."""
    side = network.config.closer_side
    box = window(seen, view)
    both = torch.cat(evidence(seen, view, box, side))[None]
    plain, mirrored = network(torch.cat([both, both.flip(-1)])).split(1)
    found = 0.5 * (plain + mirrored.flip(-1))
    height, width = seen.pictures[view].shape[1:]
    y, x = (2.0 * (torch.arange(size) + 0.5) / size - 1.0 for size in (height, width))
    x, y = (2.0 * (value - low) / (high - low) - 1.0 for value, low, high in zip((x, y), box[:2], box[2:], strict=True))
    where = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)[None]
    inside = (where.abs() < 1.0).all(dim=-1)[0]
    read = grid_sample(found, where, padding_mode="border", align_corners=False)[0, 0]
    return torch.where(inside, read, _NOTHING)


def _reduced(image: Tensor) -> Tensor:
    """(C, h, w) of (C, H, W), as large as the look takes it."""
    scale = min(1.0, LOOKED_AT / max(image.shape[1:]))
    size = [max(1, round(scale * side)) for side in image.shape[1:]]
    return interpolate(image[None], size, mode="bilinear", antialias=True, align_corners=False)[0].clamp(0.0, 1.0)
