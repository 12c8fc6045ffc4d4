"""The re-rendering error: an asset under the light that was predicted, drawn into its views and held against them."""

import math
from statistics import fmean

import torch
from torch import Tensor
from torch.nn import functional

from ..graphics.color import srgb_from_linear
from ..progress import Progress, silent
from ..report import Report
from ..structures import MaterialMaps, UvMesh, ViewSet
from ..uv.finish import finished
from .comparison import comparison
from .drawing import Drawing

SIDE = 320
"""Pixels of the longer side of a picture that is drawn at most: larger views are made smaller first."""

PSNR_CAP = 50.0
"""dB of a view at most: a nearly perfect one would outweigh all others in the mean."""

_WHAT = "check by light"


@torch.no_grad()
def check_by_light(
    mesh: UvMesh, maps: MaterialMaps, views: ViewSet, report: Report, progress: Progress = silent
) -> Tensor | None:
    """Draws the asset into the views under `maps.light`, and tells the report how near that comes to them.

    Where the report knows gains that brought the views to one exposure, what is drawn is brought back to each one's.

    Args:
        mesh: in the frame of the views' cameras.
        maps: as predicted; what is seen are those with the finishes that were set.
    Returns:
        (3, H, W) uint8 sRGB, as of `comparison`; None without a light, or where no view shows the asset.
    """
    if maps.light is None:
        report.leave_out(_WHAT, "no light was predicted: the networks of the preset say none, or nothing was seen")
        return None
    pictures, texels = _smaller(views.images)
    height, width = pictures.shape[2:]
    drawing = Drawing(mesh, finished(maps), texels)
    drawn, errors = torch.zeros_like(pictures), []
    for index, camera in enumerate(views.cameras):
        progress(index / len(views.cameras), "checking by light")
        gain = None if report.gains is None else pictures.new_tensor(report.gains[index])
        drawn[index] = drawing.under(maps.light, camera.resized(width, height), gain)
        errors.append(psnr(drawn[index], pictures[index]))
    known = [error for error in errors if error is not None]
    if not known:
        report.leave_out(_WHAT, "no view shows the asset")
        return None
    named = zip(views.called, errors, strict=True)
    report.light = {
        "harmonics": maps.light.tolist(),
        "psnr": round(fmean(known), 2),
        "views": [{"view": name, "psnr": None if error is None else round(error, 2)} for name, error in named],
    }
    return comparison(pictures, drawn).cpu()


def psnr(drawn: Tensor, picture: Tensor) -> float | None:
    """dB between two pictures (4, H, W) in sRGB, where both show the object, that is by more than half of a pixel.

    Returns:
        `PSNR_CAP` at most; None where they nowhere do.
    """
    both = (drawn[3] > 0.5) & (picture[3] > 0.5)
    if not bool(both.any()):
        return None
    error = float((drawn[:3, both] - picture[:3, both]).square().mean())
    return min(PSNR_CAP, -10.0 * math.log10(max(error, 1e-12)))


def resized(picture: Tensor, height: int, width: int) -> Tensor:
    """(4, height, width) of a picture (4, H, W), linear, straight alpha; what is transparent has no say in a colour."""
    smaller = height < picture.shape[1] or width < picture.shape[2]
    premultiplied = torch.cat([picture[:3] * picture[3:], picture[3:]])[None]
    found = functional.interpolate(premultiplied, size=(height, width), mode="area" if smaller else "bilinear")[0]
    return torch.cat([found[:3] / found[3:].clamp(min=1e-6), found[3:]])


def _smaller(images: Tensor) -> tuple[Tensor, int]:
    """(V, 4, h, w) sRGB of views (V, 4, H, W), `SIDE` at most, and the whole pixels of theirs along a side of one."""
    scale = max(1.0, max(images.shape[2:]) / SIDE)
    height, width = (max(1, round(side / scale)) for side in images.shape[2:])
    result = images.new_zeros(len(images), 4, height, width)
    # View by view: of all together the work space would be as large as the views.
    for small, image in zip(result, images, strict=True):
        if scale == 1.0:
            small[:] = image
        else:
            small[:] = resized(image, height, width)
        shown = small[3] > 0.0
        small[:3, shown] = srgb_from_linear(small[:3, shown])
    return result, int(scale)
