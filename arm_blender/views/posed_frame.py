"""One frame of a transforms.json: a picture, its camera to world matrix, and whatever else the file says of it."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..errors import CameraError
from ..graphics.borders import Rectangle
from ..graphics.cameras import Camera

PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
"""Camera models that are pinholes once their distortion is 0."""

LARGEST = 1e9
"""Of any number in a file. Larger ones mean nothing, and the squares of some leave the range of float32."""

_FOCALS = 1e-3, 1e6
"""Pixels: beyond these a picture is all around the camera, or a point."""


@dataclass(frozen=True)
class PosedFrame:
    """One frame of a file: a picture and its camera, which is complete once the picture's size is known.

    Attributes:
        image: the picture; it exists, inside the file's folder.
        c2w: (4, 4) float32, rigid, OpenGL axes.
        fields: the frame's own fields over the file's.
        weight: how much the view counts in the texture, >= 0.
        where: file and frame, for messages.
        model: of the camera, by COLMAP's names.
        distortion: those of its coefficients that are not 0.
        mask: of the picture, where the frame names one, or one lies beside it.
    """

    image: Path
    c2w: Tensor
    fields: dict[str, Any]
    weight: float
    where: str
    model: str
    distortion: dict[str, float]
    mask: Path | None

    @property
    def is_bent(self) -> bool:
        """Whether the lens is anything but a pinhole."""
        return bool(self.distortion) or self.model not in PINHOLES

    @property
    def ground(self) -> float | None:
        """Height (Z) of what the object stands on; None where the file does not say."""
        return self._number("ground")

    @property
    def varying_exposure(self) -> bool:
        """Whether the camera exposed by itself."""
        return self.fields.get("varying_exposure") is True

    def known(self, width: int, height: int) -> Rectangle | None:
        """The pixels of the picture, of `width` x `height`, that a camera took; None where the file does not say.

        Raises:
            CameraError: they are no rectangle in the picture.
        """
        value = self.fields.get("known")
        if value is None:
            return None
        whole = isinstance(value, list) and len(value) == 4 and all(type(side) is int for side in value)
        if not whole or not (0 <= value[0] < value[2] <= width and 0 <= value[1] < value[3] <= height):
            raise CameraError(
                f"{self.where}: known is {repr(value)[:40]}; give left, top, right and bottom in pixels of the picture"
            )
        left, top, right, bottom = value
        return left, top, right, bottom

    def is_of_stored(self, width: int, height: int, orientation: int) -> bool | None:
        """Whether w and h are of the picture as its file stores it, not as it is shown; None where they do not say.

        Args:
            width: of the picture as it is shown; so is `height`.
            orientation: by EXIF, 1 to 8.
        """
        if orientation not in (5, 6, 7, 8) or width == height or None in (self._number("w"), self._number("h")):
            return None
        wide = self._side("w", width) > self._side("h", height)
        return wide != (width > height)

    def camera(self, width: int, height: int) -> Camera:
        """The camera of the picture, whose size is `width` x `height` pixels.

        Raises:
            CameraError: there are no intrinsics, they are no numbers, or they are for a picture of another shape.
        """
        stated = self._side("w", width), self._side("h", height)
        scale_x, scale_y = width / stated[0], height / stated[1]
        # Half a pixel of rounding in a scaled picture is no other shape.
        if abs(scale_x / scale_y - 1.0) > 1.0 / min(width, height):
            size = f"{stated[0]:g}x{stated[1]:g}"
            raise CameraError(f"{self.where}: w, h say {size}, the picture is {width}x{height}; correct w and h")
        focal_x, focal_y = self._focals(*stated)
        center_x, center_y = self._number("cx"), self._number("cy")
        K = torch.tensor(
            [
                [focal_x * scale_x, 0.0, (stated[0] / 2.0 if center_x is None else center_x) * scale_x],
                [0.0, focal_y * scale_y, (stated[1] / 2.0 if center_y is None else center_y) * scale_y],
                [0.0, 0.0, 1.0],
            ]
        )
        return Camera(self.c2w, K, width, height)

    def _focals(self, width: float, height: float) -> tuple[float, float]:
        """Focal lengths in pixels of a picture of the stated size."""
        focal_x, focal_y = self._number("fl_x"), self._number("fl_y")
        angle_x, angle_y = self._number("camera_angle_x"), self._number("camera_angle_y")
        for name, angle in (("camera_angle_x", angle_x), ("camera_angle_y", angle_y)):
            if angle is not None and not 0.0 < angle < math.pi:
                raise CameraError(f"{self.where}: {name} is {angle:g}; give radians between 0 and pi")
        for name, focal in (("fl_x", focal_x), ("fl_y", focal_y)):
            if focal is not None and not focal > 0.0:
                raise CameraError(f"{self.where}: {name} is {focal:g}; give a positive focal length in pixels")
        if focal_x is None and angle_x is not None:
            focal_x = _focal(width, angle_x)
        if focal_y is None and angle_y is not None:
            focal_y = _focal(height, angle_y)
        focal = focal_x or focal_y
        if focal is None:
            raise CameraError(f"{self.where}: no camera_angle_x and no fl_x; add the field of view or the focal length")
        focals = focal_x or focal, focal_y or focal
        for focal in focals:
            if not _FOCALS[0] <= focal <= _FOCALS[1]:
                raise CameraError(f"{self.where}: the focal length is {focal:g} pixels; correct it or camera_angle_x")
        return focals

    def _side(self, name: str, actual: int) -> float:
        """The stated width or height, pixels; the picture's own where the file says nothing."""
        side = self._number(name)
        if side is None:
            return float(actual)
        if not side >= 1.0:
            raise CameraError(f"{self.where}: {name} is {side:g}; give the size of the picture in pixels")
        return side

    def _number(self, name: str) -> float | None:
        return number(self.fields.get(name), name, self.where)


def _focal(side: float, angle: float) -> float:
    """Pixels of the focal length under which `side` pixels span `angle`; infinite where its tangent is 0."""
    half = math.tan(angle / 2.0)
    return side / (2.0 * half) if half > 0.0 else math.inf


def number(value: Any, name: str, where: str) -> float | None:
    """`value` as a finite float; None where the field is absent."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise CameraError(f"{where}: {name} is {repr(value)[:40]}; give a number, at most {LARGEST:g}")
    return float(value)
