"""Photographs out of a video: of each stretch of time the sharpest frame."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import ArmError, InputImageError
from ..machine.libraries import is_there
from ..progress import Progress
from .pictures import sharpness

logger = logging.getLogger(__name__)

FRAMES = 40
"""Of a video, at most: nine degrees apart where it goes once around."""

FEWEST_FRAMES = 8
"""Below which no solution is to be trusted."""

_LOOKED_AT = 6
"""Frames of a stretch that are looked at, at most: neighbours in time are alike."""

_SIDE = 640
"""Pixels of the longer side at which sharpness is measured: noise and codecs have the rest."""


def frames_of(path: Path, folder: Path, progress: Progress) -> list[Path]:
    """Writes the sharpest frame of each stretch of a video as a picture, upright.

    Args:
        path: of an mp4 or mov.
        folder: where the pictures go, as frame_0001.png; it exists.
        progress: told each frame that is looked at.
    Returns:
        The pictures in order, at most `FRAMES`, spread evenly.
    Raises:
        InputImageError: no video, damaged, or with fewer than `FEWEST_FRAMES` frames.
        ArmError: PyAV is not installed.
    """
    if not path.is_file():
        raise InputImageError(f"{path}: no such file; check the path")
    if not is_there("av"):
        raise ArmError(f"{path}: a video needs PyAV: pip install av, or give a folder of photographs")
    import av

    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise InputImageError(f"{path}: has no pictures; give a video")
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            count = stream.frames or _counted(path)
            if count < FEWEST_FRAMES:
                raise InputImageError(
                    f"{path}: {count} frames; walk once around the object, slowly, for 20 seconds or more"
                )
            return _sharpest(container.decode(stream), count, folder, progress)
    except av.error.FFmpegError as error:
        logger.debug("%s: %s", path, error)
        raise InputImageError(f"{path}: not a readable video; give an mp4 or mov, or photographs") from error


def _counted(path: Path) -> int:
    """Frames of a video whose head does not tell."""
    import av

    with av.open(str(path)) as container:
        return sum(packet.size > 0 for packet in container.demux(video=0))


def _sharpest(frames: Any, count: int, folder: Path, progress: Progress) -> list[Path]:
    """Writes the sharpest frame of each of `FRAMES` stretches, or every frame where there are no more."""
    stretches = min(FRAMES, count)
    step = max(1, count // (stretches * _LOOKED_AT))
    found: list[Path] = []
    best: tuple[float, Callable[[], NDArray[np.uint8]]] | None = None
    stretch = 0
    for number, frame in enumerate(frames):
        progress(min(number / count, 1.0), f"looking at frame {number + 1} of {count}")
        if number * stretches // count > stretch:
            found += _written(best, folder, len(found))
            stretch, best = number * stretches // count, None
        if number % step and best is not None:
            continue
        scale = max(1.0, max(frame.width, frame.height) / _SIDE)
        grey = frame.reformat(round(frame.width / scale), round(frame.height / scale), "gray").to_ndarray()
        measured = sharpness(grey)
        if best is None or measured > best[0]:
            best = measured, lambda frame=frame: _upright(frame)
    return found + _written(best, folder, len(found))


def _upright(frame: Any) -> NDArray[np.uint8]:
    """(H, W, 3) of a frame, turned as the video says that it is to be shown."""
    return np.ascontiguousarray(np.rot90(frame.to_ndarray(format="rgb24"), round(frame.rotation / 90.0)))


def _written(best: tuple[float, Callable[[], NDArray[np.uint8]]] | None, folder: Path, index: int) -> list[Path]:
    if best is None:
        return []
    path = folder / f"frame_{index + 1:04d}.png"
    Image.fromarray(best[1]()).save(path, compress_level=1)
    return [path]
