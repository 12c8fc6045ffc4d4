"""Masks found anew once the cameras are known: what the pictures say together is more than what each says alone."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from ...progress import Progress
from ...report import DOUBTFUL
from ...views.masks import doubt, sees_something
from ..masks.eyes import Eye
from ..masks.joint_look import TOGETHER, joint_masks
from .solver import Solution
from .standing import Upright
from .working_copies import WorkingCopy


def looked_at_again(
    copies: Sequence[WorkingCopy], colors: Path, solution: Solution, stand: Upright, progress: Progress
) -> list[WorkingCopy]:
    """The copies with masks by all pictures together; those that somebody gave stay.

    Args:
        copies: of the pictures that have a camera, in their order.
        colors: folder of the copies with their colours.
        solution: their cameras.
        stand: where the object is.
        progress: is told each picture.
    Raises:
        CheckpointError: the network's weights are damaged.
    """
    guessed = [copy.is_guessed for copy in copies]
    if not any(guessed):
        return list(copies)

    def picture(view: int) -> Tensor:
        with Image.open(colors / copies[view].name) as image:
            return torch.from_numpy(np.array(image)).permute(2, 0, 1) / 255.0

    eyes = [Eye.posed(c2w, lens) for c2w, lens in zip(stand.c2w(solution.w2c), solution.lenses, strict=True)]
    alphas = [copy.mask for copy in copies]
    masks = joint_masks(picture, alphas, eyes, stand.ground, progress)
    if masks is None:
        return list(copies)
    return [_with(copy, mask) if asked else copy for copy, mask, asked in zip(copies, masks, guessed, strict=True)]


def _with(copy: WorkingCopy, mask: Tensor) -> WorkingCopy:
    """The copy with another mask, where that shows an object."""
    if not sees_something(mask):
        return copy
    why = doubt(mask)
    return replace(copy, mask=mask, told=(TOGETHER, *([f"{DOUBTFUL}{why}"] if why else [])))
