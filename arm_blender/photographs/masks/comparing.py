"""The masks of clean views held against each other, in their files."""

from collections.abc import Sequence
from pathlib import Path

import torch

from ...graphics.borders import Rectangle
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

    Masks that somebody gave are believed.

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
    masks = torch.stack([read_image(picture)[3:] for picture in pictures])
    found = agreed(masks, cameras, progress, ground, known)
    words, dropped = {}, []
    for index, picture in enumerate(pictures):
        if index not in found.words or not is_guessed(ways[index]):
            continue
        words[index] = found.words[index]
        if index in found.dropped:
            dropped.append(index)
        elif not torch.equal(found.masks[index], masks[index]):
            write_png(picture, torch.cat([read_image(picture)[:3], found.masks[index]]), srgb=True)
    return words, tuple(dropped)
