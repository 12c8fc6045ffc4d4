"""The maps of an asset as 8-bit PNGs: colours in sRGB, everything else as it is."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from ..errors import ArmError
from ..graphics.color import bytes_from_unit, srgb_from_linear
from ..machine.files import whole_file
from ..structures import MaterialMaps, Regions
from ..uv.normal_map import unit_from_normals
from ..views.image_io import read_image, write_png

FOLDER = "textures"
"""Beside the files that name them."""


PREDICTED = "predicted"
"""Folder inside of `FOLDER`: maps as predicted, where finishes were set over them."""

SET_BY_HAND = ("albedo", "roughness", "metallic")
"""Maps that a finish changes."""

REGIONS = "regions.png"
"""Inside of `FOLDER`, a picture with a palette: the number of every texel's region as it is, in a colour of its own."""

COLORS = (
    (255, 255, 255),
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
    (120, 120, 120),
)
"""sRGB of region 0 (none), 1 and so on: Okabe and Ito, "Color universal design", 2008: all eyes tell them apart."""


def write_regions(maps: MaterialMaps, folder: Path) -> None:
    """The regions' numbers, and the predicted maps where finishes were set over them.

    Args:
        maps: as predicted; without regions nothing is written.
        folder: of the textures, which exists.
    Raises:
        OutputError: a file cannot be written.
    """
    if maps.regions is None:
        return
    picture = Image.fromarray(maps.regions.index.cpu().numpy(), "P")
    picture.putpalette([channel for color in COLORS for channel in color])
    with whole_file(folder / REGIONS) as temporary:
        picture.save(temporary)
    if maps.regions.finishes:
        (folder / PREDICTED).mkdir(exist_ok=True)
        for name in SET_BY_HAND:
            write_png(folder / PREDICTED / f"{name}.png", maps.image(name), name == "albedo")


def read_maps(
    folder: Path, values: Mapping[str, float], regions: Callable[[Tensor], Regions], detailed: bool
) -> MaterialMaps:
    """The predicted maps that `write_textures` and `write_regions` wrote.

    Args:
        folder: of the textures.
        values: of the maps that are one, by name.
        regions: makes the regions of their numbers; where it sets finishes, the predicted maps lie in `PREDICTED`.
        detailed: whether there is a normal map; one of an earlier asset may lie there still.
    Raises:
        InputImageError: a picture is missing or cannot be read.
        ArmError: there are no regions.
    """
    try:
        with Image.open(folder / REGIONS) as picture:
            if picture.mode != "P" or picture.width != picture.height:
                raise OSError(f"it is {picture.mode}, {picture.size}")
            index = torch.from_numpy(np.array(picture, dtype=np.uint8))
    except OSError as error:
        raise ArmError(f"{folder / REGIONS}: no regions of ours ({error}); generate the asset again") from error
    found = regions(index)
    changed = folder / PREDICTED if found.finishes else folder

    def texels(name: str) -> Tensor | float:
        return values[name] if name in values else _stored(read_image(changed / f"{name}.png")[:1])

    normal = 2.0 * _stored(read_image(folder / "normal.png")[:3]) - 1.0 if detailed else None
    albedo, baked = read_image(changed / "albedo.png")[:3], read_image(folder / "baked.png")[:3]
    return MaterialMaps(albedo, baked, texels("roughness"), texels("metallic"), normal, found)


def _stored(image: Tensor) -> Tensor:
    """Data as the bytes of a picture have it, of what was read as colour."""
    return bytes_from_unit(srgb_from_linear(image)) / 255.0


def write_textures(maps: MaterialMaps, folder: Path) -> None:
    """`albedo.png`, `roughness.png`, `metallic.png`, `baked.png`, and `normal.png` where there is detail to tell.

    A map that is one value is written as a small picture.

    Args:
        maps: to write.
        folder: is made.
    Raises:
        OutputError: a file cannot be written.
    """
    folder.mkdir(exist_ok=True)
    for name, srgb in (("albedo", True), ("roughness", False), ("metallic", False), ("baked", True)):
        write_png(folder / f"{name}.png", maps.image(name), srgb)
    if maps.normal is not None:
        write_png(folder / "normal.png", unit_from_normals(maps.normal), srgb=False)
