"""One picture per object: what went in, and the shapes that came out beside the truth."""

from collections.abc import Sequence

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageOps
from torch import Tensor
from torch.nn.functional import interpolate

from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.graphics.color import bytes_from_unit, composite, srgb_from_linear
from arm_blender.graphics.meshes import face_normals
from arm_blender.graphics.raster.rasterize import rasterize
from arm_blender.structures import TriangleMesh, ViewSet

TILE = 192
"""Pixels a side of every picture."""
CAPTION = 14
"""Pixels of a line of text."""
SIDES = (30.0, 210.0)
"""Azimuths that each shape is shown from, degrees."""


def contact_sheet(views: ViewSet, shapes: dict[str, TriangleMesh]) -> Image.Image:
    """The views in the first row, then the normals of each shape from two sides in the second.

    Args:
        views: at most as many as fit are shown.
        shapes: by caption.
    """
    columns = max(len(SIDES) * len(shapes), min(len(views.cameras), 6))
    inputs = composite(srgb_from_linear(views.images[:columns, :3]), views.images[:columns, 3:], 1.0)
    rows = [[(f"view {index}", picture) for index, picture in enumerate(inputs)]]
    rows.append(
        [
            (f"{caption}, {azimuth:.0f}°", normal_picture(shape, orbit_camera(azimuth, 20.0, 6.0, 26.0, TILE, TILE)))
            for caption, shape in shapes.items()
            for azimuth in SIDES
        ]
    )
    return tiled(rows, columns)


def tiled(rows: Sequence[Sequence[tuple[str, Tensor | None]]], columns: int, tile: int = TILE) -> Image.Image:
    """Pictures in rows, each below its caption.

    Args:
        rows: of captions and pictures (3, H, W) in [0, 1], made `tile` pixels a side; None leaves a gap.
        columns: of the sheet.
    """
    sheet = Image.new("RGB", (columns * tile, len(rows) * (tile + CAPTION)), "white")
    draw = ImageDraw.Draw(sheet)
    for row, tiles in enumerate(rows):
        for column, (caption, picture) in enumerate(tiles):
            left, top = column * tile, row * (tile + CAPTION)
            draw.text((left + 4, top + 1), caption, fill="black")
            if picture is not None:
                sheet.paste(_image(_sized(picture, tile)), (left, top + CAPTION))
    return sheet


def square_tile(picture: Image.Image) -> Tensor:
    """(3, TILE, TILE) in [0, 1]: a whole picture, before white where it is no square."""
    values = np.array(ImageOps.pad(picture.convert("RGB"), (TILE, TILE), color="white"))
    return torch.from_numpy(values).permute(2, 0, 1) / 255.0


def normal_picture(mesh: TriangleMesh, camera: Camera) -> Tensor:
    """(3, H, W) in [0, 1]: the faces' normals in the camera's frame as colours, white behind them.

    Flat, not smooth, so that every dent of the surface shows; a face that is wound the wrong way shows without blue.
    """
    fine = camera.resized(2 * camera.width, 2 * camera.height)
    face_id = rasterize(mesh.vertices, mesh.faces, fine).face_id
    normals = face_normals(mesh.vertices, mesh.faces) @ camera.c2w[:3, :3]  # (F, 3) camera
    picture = torch.where(face_id[..., None] >= 0, 0.5 + 0.5 * normals[face_id.clamp(min=0)], 1.0).permute(2, 0, 1)
    return interpolate(picture[None], scale_factor=0.5, mode="area")[0]


def _sized(picture: Tensor, tile: int) -> Tensor:
    if picture.shape[-2:] == (tile, tile):
        return picture
    return interpolate(picture[None], size=(tile, tile), mode="bilinear", antialias=True, align_corners=False)[0]


def _image(picture: Tensor) -> Image.Image:
    """(3, H, W) in [0, 1] as 8 bit."""
    return Image.fromarray(bytes_from_unit(picture).permute(1, 2, 0).contiguous().numpy())
