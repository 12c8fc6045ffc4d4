"""The light of the views beside an asset, as an environment, and the pictures that the asset was checked by."""

from pathlib import Path

import OpenImageIO as oiio
from PIL import Image
from torch import Tensor

from ..graphics.light.harmonic_light import environment_of
from ..machine.files import whole_file

LIGHT = "light.exr"
"""Equirectangular, linear Rec.709, as Blender takes environments (`graphics.light.environment`): the zenith on top."""

COMPARISON = "comparison.png"
"""The views beside the asset under that light."""


def write_light(light: Tensor, path: Path) -> None:
    """An environment with these harmonics (9, 3) as an EXR of halves, whole or not at all.

    Raises:
        OutputError: it cannot be written.
    """
    radiance = environment_of(light).radiance.permute(1, 2, 0).contiguous().cpu().numpy()
    height, width = radiance.shape[:2]
    spec = oiio.ImageSpec(width, height, 3, "half")
    spec.attribute("compression", "zip")
    spec.attribute("DateTime", "1970:01:01 00:00:00")  # Else that of now: the same light is the same file.
    with whole_file(path) as temporary:
        sink = oiio.ImageOutput.create(str(temporary))
        written = sink.open(str(temporary), spec) and sink.write_image(radiance)
        if not (sink.close() and written):
            raise OSError(0, sink.geterror() or "no space")


def write_comparison(sheet: Tensor, path: Path) -> None:
    """A sheet (3, H, W) uint8 sRGB, as of `light_check.comparison`, as a PNG, whole or not at all.

    Raises:
        OutputError: it cannot be written.
    """
    with whole_file(path) as temporary:
        Image.fromarray(sheet.permute(1, 2, 0).cpu().numpy()).save(temporary)
