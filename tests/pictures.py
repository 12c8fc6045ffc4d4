"""Pictures that are read as an object's views: a rectangle of one grey on nothing."""

from pathlib import Path

import torch

from arm_blender.views.image_io import write_png

SIZE = 64
"""Pixels a side."""


def picture(shade: float = 0.5, filled: bool = True) -> torch.Tensor:
    """(4, 64, 64) linear: rows 16 to 47 and columns 20 to 43 are opaque, or nothing is."""
    image = torch.full((4, SIZE, SIZE), shade)
    image[3] = 0.0
    image[3, 16:48, 20:44] = float(filled)
    return image


def a_picture(path: Path) -> Path:
    """The file of one."""
    write_png(path, picture(), srgb=True)
    return path


def six_pictures(folder: Path) -> Path:
    """A folder of six, `0.png` to `5.png`, each lighter than the one before."""
    folder.mkdir()
    for index in range(6):
        write_png(folder / f"{index}.png", picture((index + 1) / 6.0), srgb=True)
    return folder
