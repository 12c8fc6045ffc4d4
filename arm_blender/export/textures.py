"""The maps of an asset as 8-bit PNGs: colours in sRGB, everything else as it is."""

from pathlib import Path

from torch import Tensor

from ..structures import MaterialMaps
from ..uv.maps import CONSTANT_SIDE, ONE_STEP, constant_value
from ..uv.normal_map import unit_from_normals
from ..views.image_io import write_png

FOLDER = "textures"
"""Beside the files that name them."""


def write_textures(maps: MaterialMaps, folder: Path) -> None:
    """`albedo.png`, `roughness.png`, `metallic.png`, `baked.png`, and `normal.png` where there is detail to tell.

    A map that is one value is written small.

    Args:
        maps: to write.
        folder: is made.
    Raises:
        OutputError: a file cannot be written.
    """
    folder.mkdir(exist_ok=True)
    pictures: dict[str, tuple[Tensor, bool]] = {
        "albedo": (maps.albedo, True),
        "roughness": (maps.roughness, False),
        "metallic": (maps.metallic, False),
        "baked": (maps.baked, True),
    }
    if maps.normal is not None:
        pictures["normal"] = unit_from_normals(maps.normal), False
    for name, (image, srgb) in pictures.items():
        if all(constant_value(channel[None], None, ONE_STEP) is not None for channel in image):
            image = image[:, :CONSTANT_SIDE, :CONSTANT_SIDE]
        write_png(folder / f"{name}.png", image, srgb)
