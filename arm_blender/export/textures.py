"""The maps of an asset as 8-bit PNGs: colours in sRGB, everything else as it is."""

from pathlib import Path

from ..structures import MaterialMaps
from ..uv.normal_map import unit_from_normals
from ..views.image_io import write_png

FOLDER = "textures"
"""Beside the files that name them."""


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
