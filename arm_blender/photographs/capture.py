"""What the parts of this room hand to each other: photographs with their lenses and poses."""

from dataclasses import dataclass, field
from pathlib import Path

from torch import Tensor

from ..views.mask_files import MASK_FILE

OF_CAMERAS = {".jpg", ".jpeg", ".heic", ".heif"}
"""Formats that phones and cameras write."""


@dataclass(frozen=True)
class Lens:
    """How a camera maps rays to pixels, by COLMAP's camera models (https://colmap.github.io/cameras.html).

    Attributes:
        model: COLMAP's name, such as "SIMPLE_RADIAL" or "OPENCV".
        parameters: in COLMAP's order and units: pixels for focal lengths and centre, the rest without.
        width: pixels of the picture, as it is shown upright.
        height: as `width`.
    """

    model: str
    parameters: tuple[float, ...]
    width: int
    height: int


@dataclass(frozen=True)
class PosedPhotograph:
    """A photograph whose camera is known.

    Attributes:
        path: of the picture.
        c2w: (4, 4) float64, rigid, OpenGL axes: the camera looks along -Z.
        lens: of that picture.
        mask: of a picture whose grey level is the object's alpha, where one lies beside it.
        mask_way: how that was come by.
    """

    path: Path
    c2w: Tensor
    lens: Lens
    mask: Path | None = None
    mask_way: str = MASK_FILE


@dataclass(frozen=True)
class Capture:
    """Photographs of one object, posed in one frame.

    Attributes:
        photographs: those with a camera.
        points: (P, 3) float64, solved surface points in that frame; may be none.
        left_out: of every other picture its name, and why it has no camera.
        ground: height (Z) of what the object stands on, where that is known.
        solved: nobody said the cameras; they were found from the pictures.
    """

    photographs: tuple[PosedPhotograph, ...]
    points: Tensor
    left_out: dict[str, str] = field(default_factory=dict)
    ground: float | None = None
    solved: bool = False

    @property
    def varying_exposure(self) -> bool:
        """Whether a camera that exposes by itself took them, as far as is known: programs that pose write PNG."""
        return self.solved or any(photograph.path.suffix.lower() in OF_CAMERAS for photograph in self.photographs)
