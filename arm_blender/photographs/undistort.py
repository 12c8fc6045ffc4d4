"""From what a lens drew to what a pinhole would have: where rays land comes from pycolmap, pixels through torch.

pycolmap knows all of COLMAP's lenses, and solving needs it anyway; OpenCV's wheels want numpy 2, and Blender 4.2 brings
1.26. It is asked once for each lens, for a table of rays;
every window of every picture is then drawn from the file's own pixels in one step, at the size that is wanted.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

from ..errors import CameraError
from ..progress import Progress
from .capture import Lens
from .colmap.runner import arrays

SIDE = 257
"""Entries a side of a table: between two a lens bends by less than a fortieth of a pixel of 12 megapixels."""

_PINHOLES = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4}
"""Lenses that bend nothing, and how many parameters they have."""


@dataclass(frozen=True)
class RayTable:
    """Where the rays of a lens land in its picture.

    Attributes:
        bounds: tangents of the rays at the sides: left, top, right, bottom, x to the right and y down.
        places: (R, R, 2) float32 of rays in even steps between those: shares of the picture's width and height, whose
            borders are 0 and 1; NaN for rays that the lens does not see.
    """

    bounds: tuple[float, float, float, float]
    places: Tensor

    def of_window(self, K: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
        """Where the pixels of a pinhole's picture lie in that of the lens; both look along the same axis.

        Args:
            K: (3, 3) intrinsics of the pinhole, pixels.
            width: of its picture, pixels.
            height: as `width`.
        Returns:
            (height, width, 2) places in [0, 1], and (height, width) bool: the picture shows it. The others have the
            place of one near by.
        """
        left, top, right, bottom = self.bounds
        K = K.double()
        x = ((torch.arange(width, dtype=torch.float64) + 0.5 - K[0, 2]) / K[0, 0] - left) / (right - left)
        y = ((torch.arange(height, dtype=torch.float64) + 0.5 - K[1, 2]) / K[1, 1] - top) / (bottom - top)
        rays = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
        within = ((rays >= 0.0) & (rays <= 1.0)).all(dim=-1)
        table = self.places.permute(2, 0, 1)[None]
        grid = (rays * 2.0 - 1.0).float()[None]
        places = grid_sample(table, grid, mode="bilinear", padding_mode="border", align_corners=True)
        places = places[0].permute(1, 2, 0)
        shown = within & ((places >= 0.0) & (places <= 1.0)).all(dim=-1)
        return places.nan_to_num(nan=0.5).clamp(0.0, 1.0), shown


def ray_tables(lenses: Iterable[Lens], progress: Progress) -> dict[Lens, RayTable]:
    """A table for each lens; pycolmap is only asked where one bends.

    Raises:
        CameraError: a lens has numbers with which it sees nothing.
        ArmError: a lens bends, and pycolmap is not there.
    """
    distinct = list(dict.fromkeys(lenses))
    tables = {lens: _straight(lens) for lens in distinct if lens.model in _PINHOLES}
    bent = [lens for lens in distinct if lens not in tables]
    if bent:
        listed = [[lens.model, list(lens.parameters), lens.width, lens.height] for lens in bent]
        made = arrays("ray_tables", {"lenses": listed, "side": SIDE}, progress, "reading the lenses")
        for lens, bounds, places in zip(bent, made["bounds"].tolist(), made["places"], strict=True):
            if not (bounds[0] < bounds[2] and bounds[1] < bounds[3]):
                raise CameraError(
                    f"{lens.model} {list(lens.parameters)}: such a lens sees nothing; correct its numbers"
                )
            tables[lens] = RayTable(tuple(bounds), torch.from_numpy(places))
    return tables


def place_of(point: Tensor, c2w: Tensor, table: RayTable) -> tuple[float, float]:
    """Where a world point (3,) lies in the picture of a lens at `c2w` (4, 4): shares of width and height, in [0, 1].

    The middle where it is behind the camera; the nearest place where it is beyond the border.
    """
    x, y, z = (c2w[:3, :3].T @ (point - c2w[:3, 3])).tolist()
    if z >= 0.0:
        return 0.5, 0.5
    K = torch.tensor([[1.0, 0.0, 0.5 + x / z], [0.0, 1.0, 0.5 - y / z], [0.0, 0.0, 1.0]])
    column, row = table.of_window(K, 1, 1)[0][0, 0].tolist()
    return column, row


def undistorted(image: Tensor, table: RayTable, K: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """What a pinhole sees of a picture.

    Args:
        image: (4, H, W) linear, straight alpha: the whole picture, at any size.
        table: of its lens.
        K: (3, 3) intrinsics of the pinhole, pixels.
        width: of the result, pixels.
        height: as `width`.
    Returns:
        (4, height, width), and (height, width) bool: which of its pixels the picture shows. Beyond, the nearest pixel
        of the picture is repeated.
    """
    places, known = table.of_window(K, width, height)
    if not bool(known.any()):
        return image.new_zeros(4, height, width), known
    source, places = _needed(image, places, known)
    opaque = bool((source[3] == 1.0).all())
    source = source[:3] if opaque else torch.cat([source[:3] * source[3:], source[3:]])
    # Averaged first: samples that lie further apart than the picture's pixels would skip some.
    steps = _step(places, known, dim=0), _step(places, known, dim=1)
    smaller = [
        max(1, round(size / max(1.0, size * step))) for size, step in zip(source.shape[:0:-1], steps, strict=True)
    ]
    if smaller[1] < source.shape[1] or smaller[0] < source.shape[2]:
        source = interpolate(source[None], size=(smaller[1], smaller[0]), mode="area")[0]
    drawn = grid_sample(
        source[None], (places * 2.0 - 1.0)[None], mode="bicubic", padding_mode="border", align_corners=False
    )[0]
    if opaque:
        return torch.cat([drawn.clamp(0.0, 1.0), torch.ones_like(drawn[:1])]), known
    alpha = drawn[3:].clamp(0.0, 1.0)
    return torch.cat([(drawn[:3] / alpha.clamp(min=1e-6)).clamp(0.0, 1.0), alpha]), known


def _straight(lens: Lens) -> RayTable:
    """The table of a pinhole."""
    if len(lens.parameters) != _PINHOLES[lens.model]:
        raise CameraError(f"{lens.model} {list(lens.parameters)}: give {_PINHOLES[lens.model]} parameters")
    *focals, center_x, center_y = lens.parameters
    focal_x, focal_y = focals[0], focals[-1]
    left, right = -center_x / focal_x, (lens.width - center_x) / focal_x
    top, bottom = -center_y / focal_y, (lens.height - center_y) / focal_y
    corners = torch.tensor([[[0.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [1.0, 1.0]]])
    return RayTable((left, top, right, bottom), corners)


def _needed(image: Tensor, places: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """The part of `image` in which the `known` ones of `places` lie and a few pixels around, and the places in it."""
    size = torch.tensor([image.shape[2], image.shape[1]])
    shown = places[known]
    low = (shown.amin(dim=0) * size - 4.0).floor().clamp(min=0.0)
    high = torch.minimum((shown.amax(dim=0) * size + 4.0).ceil(), size)
    (left, top), (right, bottom) = low.int().tolist(), high.int().tolist()
    return image[:, top:bottom, left:right], ((places * size - low) / (high - low)).clamp(0.0, 1.0)


def _step(places: Tensor, known: Tensor, dim: int) -> float:
    """How far apart two neighbours along `dim` are in the picture, as a share of it: the middle one of all."""
    both = known.narrow(dim, 1, known.shape[dim] - 1) & known.narrow(dim, 0, known.shape[dim] - 1)
    apart = places.diff(dim=dim)[..., 1 - dim].abs()[both]
    return float(apart.median()) if len(apart) else 0.0
