"""The masks of clean views held against each other, in their files."""

from collections.abc import Sequence
from pathlib import Path

import torch

from ...graphics.borders import Rectangle, cut_sides
from ...graphics.cameras import Camera
from ...progress import Progress, silent
from ...views.image_io import read_image, write_png
from .agreement import agreed
from .joint_look import is_guessed


def compare(
    pictures: Sequence[Path],
    cameras: Sequence[Camera],
    known: Sequence[Rectangle],
    ways: Sequence[str],
    progress: Progress = silent,
    ground: float | None = None,
) -> tuple[dict[int, str], tuple[int, ...]]:
    """Mends the alpha of views whose masks most others contradict; the files are written anew.

    Masks that somebody gave are believed. A view that cuts its object says too little to be compared.

    Args:
        pictures: of square views of one size, with alpha.
        cameras: of them; the object lies about the origin, its longest side about 2.
        known: the pixels of each that a camera took.
        ways: how each was cut out.
        progress: is told each view.
        ground: height (Z) of what the object stands on, where that is known.
    Returns:
        Of each view that was mended, or should be dropped, why; and which should be dropped.
    """
    if not any(is_guessed(way) for way in ways):
        return {}, ()
    alphas = [read_image(picture)[3] for picture in pictures]
    whole = [index for index, alpha in enumerate(alphas) if not any(cut_sides(alpha, known[index]))]
    if not whole:
        return {}, ()
    masks = torch.stack([alphas[index] for index in whole])[:, None]
    found = agreed(masks, [cameras[index] for index in whole], progress, ground)
    words, dropped = {}, []
    for place, index in enumerate(whole):
        if place not in found.words or not is_guessed(ways[index]):
            continue
        words[index] = found.words[place]
        if place in found.dropped:
            dropped.append(index)
        elif not torch.equal(found.masks[place], masks[place]):
            image = read_image(pictures[index])
            write_png(pictures[index], torch.cat([image[:3], found.masks[place]]), srgb=True)
    return words, tuple(dropped)
