"""Cameras of pictures as their files store them, turned to where the pictures are shown: upright, as EXIF says.

COLMAP reads pictures as they are stored; we, and every viewer, turn them.
"""

import torch
from torch import Tensor

from ..errors import CameraError
from .capture import Lens

_TURNS = {3: ((-1, 0), (0, -1)), 6: ((0, -1), (1, 0)), 8: ((0, 1), (-1, 0))}
"""By EXIF orientation: what becomes of directions in the picture, x to the right and y down."""

_SINGLE = {
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "SIMPLE_DIVISION",
    "SIMPLE_FISHEYE",
}
"""Lenses with one focal length."""

_DOUBLE = {
    "PINHOLE",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "THIN_PRISM_FISHEYE",
    "DIVISION",
    "FISHEYE",
    "EUCM",
}
"""Lenses with one for each axis."""

_TANGENTIAL = {"OPENCV": 6, "FULL_OPENCV": 6, "THIN_PRISM_FISHEYE": 6}
"""Where p1 and p2 stand among the parameters: p2 bends along x, p1 along y."""

_PRISM = {"THIN_PRISM_FISHEYE": 10}
"""Where sx1 and sy1 stand."""


def oriented(lens: Lens, c2w: Tensor, orientation: int, where: str) -> tuple[Lens, Tensor]:
    """The camera of a picture that is shown turned.

    Args:
        lens: of the picture as it is stored.
        c2w: (4, 4) of it.
        orientation: of the picture by EXIF; 1 is upright.
        where: for the message.
    Raises:
        CameraError: the picture is mirrored, or the lens is of a kind that cannot be turned.
    """
    if orientation == 1:
        return lens, c2w
    if orientation not in _TURNS or lens.model not in _SINGLE | _DOUBLE:
        what = f"EXIF orientation {orientation}, lens {lens.model}"
        raise CameraError(f"{where}: cannot be turned upright ({what}); turn the pictures, and solve the cameras again")
    (xx, xy), (yx, yy) = _TURNS[orientation]

    def turned(x: float, y: float) -> tuple[float, float]:
        return xx * x + xy * y, yx * x + yy * y

    parameters = list(lens.parameters)
    at = 1 if lens.model in _SINGLE else 2
    if at == 2 and xx == 0:
        parameters[0], parameters[1] = parameters[1], parameters[0]
    # Around the middle of the picture, which stays the middle.
    width, height = (lens.height, lens.width) if xx == 0 else (lens.width, lens.height)
    x, y = turned(parameters[at] - lens.width / 2.0, parameters[at + 1] - lens.height / 2.0)
    parameters[at], parameters[at + 1] = x + width / 2.0, y + height / 2.0
    if lens.model in _TANGENTIAL:
        place = _TANGENTIAL[lens.model]
        parameters[place + 1], parameters[place] = turned(parameters[place + 1], parameters[place])
    if lens.model in _PRISM:
        place = _PRISM[lens.model]
        parameters[place], parameters[place + 1] = turned(parameters[place], parameters[place + 1])
    # OpenGL's y points up: the turn is the other way round.
    turn = torch.eye(4, dtype=c2w.dtype)
    turn[:2, :2] = torch.tensor([[xx, -xy], [-yx, yy]], dtype=c2w.dtype)
    return Lens(lens.model, tuple(parameters), width, height), c2w @ turn.T
