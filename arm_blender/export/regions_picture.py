"""A picture of an object's regions for people: the object from two sides in flat colours, numbers, and a list."""

from pathlib import Path

import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from torch.nn.functional import avg_pool2d

from ..graphics.cameras import orbit_camera
from ..graphics.color import bytes_from_unit, srgb_from_linear
from ..graphics.meshes import in_unit_ball, vertex_normals
from ..graphics.raster.rasterize import interpolate, rasterize
from ..knobs.finishes import name_of
from ..machine.files import whole_file
from ..structures import Regions, RelightableAsset
from .textures import COLORS

SIDE = 480
"""Pixels of the object from one side."""

_AZIMUTHS = (30.0, 210.0)
_ROW = 34
_LARGE, _SMALL = 26, 20
"""Pixels: heights of a line of the list and of its letters, and of those on the object."""


@torch.inference_mode()
def write_regions_picture(asset: RelightableAsset, path: Path) -> None:
    """The picture as a PNG; without regions none.

    Raises:
        OutputError: it cannot be written.
    """
    regions = asset.maps.regions
    if regions is None:
        return
    picture = Image.new("RGB", (2 * SIDE + 440, SIDE), COLORS[0])
    for place, azimuth in enumerate(_AZIMUTHS):
        picture.paste(_side(asset, regions, azimuth), (place * SIDE, 0))
    _list(ImageDraw.Draw(picture), regions)
    with whole_file(path) as temporary:
        picture.save(temporary)


def _side(asset: RelightableAsset, regions: Regions, azimuth_deg: float) -> Image.Image:
    """(SIDE, SIDE) of the object from one side: the front a little from above, the back a little from below."""
    mesh = asset.mesh
    vertices = in_unit_ball(mesh.vertices)
    elevation = 25.0 if azimuth_deg < 180.0 else -15.0
    camera = orbit_camera(azimuth_deg, elevation, 4.0, 30.0, SIDE, SIDE)
    fragments = rasterize(vertices, mesh.faces, camera)
    number = torch.zeros(SIDE, SIDE, dtype=torch.long)
    uv = interpolate(mesh.uvs, mesh.face_uvs, fragments)[:, fragments.mask]
    texels = len(regions.index)
    column, row = (uv[0] * texels).long(), ((1.0 - uv[1]) * texels).long()
    number[fragments.mask] = regions.index[row.clamp(0, texels - 1), column.clamp(0, texels - 1)].long()
    normal = interpolate(vertex_normals(vertices, mesh.faces), mesh.faces, fragments)
    facing = (normal * torch.nn.functional.normalize(camera.center, dim=0)[:, None, None]).sum(dim=0).abs()
    shade = torch.where(fragments.mask, 0.7 + 0.3 * facing.clamp(0.0, 1.0), 1.0)  # Else nobody sees the shape.
    color = torch.tensor(COLORS)[number] * shade[..., None]
    picture = Image.fromarray(color.round().to(torch.uint8).numpy(), "RGB")
    draw = ImageDraw.Draw(picture)
    for one in range(1, regions.count + 1):
        at = _middle(number == one)
        if at is not None:
            _write(draw, at, str(one), _LARGE, anchor="mm")
    return picture


def _middle(inside: Tensor) -> tuple[int, int] | None:
    """Column and row of a pixel far inside of a region, or None where too little of it is seen to write on."""
    share = avg_pool2d(inside[None].float(), 31, stride=1, padding=15)[0]
    share = torch.where(inside, share, 0.0)
    best = int(share.argmax())
    return (best % SIDE, best // SIDE) if float(share.flatten()[best]) > 0.25 else None


def _list(draw: ImageDraw.ImageDraw, regions: Regions) -> None:
    """Number, colour in the picture, colour of the surface, share and finish, a line each."""
    left = 2 * SIDE + 12
    _write(draw, (left, 12), "no.   surface   share   set to", _SMALL)
    for number, (area, swatch) in enumerate(zip(regions.area, regions.swatch, strict=True), start=1):
        top = 20 + number * _ROW
        draw.rectangle((left, top, left + 26, top + 26), COLORS[number], (0, 0, 0))
        _write(draw, (left + 13, top + 13), str(number), _SMALL, anchor="mm")
        red, green, blue = bytes_from_unit(srgb_from_linear(torch.tensor(swatch))).tolist()
        draw.rectangle((left + 56, top, left + 116, top + 26), (red, green, blue), (0, 0, 0))
        finish = regions.finishes.get(number)
        words = f"{area:.1%}".rjust(6) + "   " + ("as predicted" if finish is None else name_of(finish))
        _write(draw, (left + 140, top), words, _SMALL)


def _write(draw: ImageDraw.ImageDraw, at: tuple[int, int], words: str, size: int, anchor: str = "la") -> None:
    draw.text(at, words, (0, 0, 0), ImageFont.load_default(size), anchor, stroke_width=2, stroke_fill=(255, 255, 255))
