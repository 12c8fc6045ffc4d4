"""Texture sets as materials: albedo, roughness and metallic that repeat, and the kind of substance that they show."""

from dataclasses import dataclass
from pathlib import Path

import OpenImageIO as oiio
import torch
from torch import Tensor
from torch.nn import functional

from arm_blender.errors import ArmError
from arm_blender.graphics.color import linear_from_srgb

from ..rendering.manifest import read_manifest

LABELS = ("metal", "plastic", "fabric", "wood", "stone", "rubber", "varnish", "other")
"""Kinds of material; a label is an index."""
NOTHING = 255
"""The label where no surface is."""
WORDS = {
    "metal": ("metal", "gold", "steel", "iron", "copper", "brass"),
    "wood": ("wood", "plank", "bark", "veneer"),
    "fabric": ("fabric", "rope", "cloth", "leather", "carpet", "wicker"),
    "plastic": ("plastic",),
    "stone": ("stone", "rock", "marble", "onyx", "brick", "tile", "asphalt", "ground", "ice", "concrete"),
}
"""Parts of a texture set's name that tell its kind; the first kind that fits counts."""
TEXELS = 256
"""A side of texture sets as they are used: finer than the pictures show them."""


@dataclass(frozen=True)
class TextureSet:
    """Maps of one material that repeat in both directions.

    Attributes:
        label: index into `LABELS`.
        maps: (5, TEXELS, TEXELS): linear albedo, roughness, metallic.
    """

    label: int
    maps: Tensor


def read_textures(data: Path) -> list[TextureSet]:
    """The texture sets of a data folder's manifest.

    Raises:
        ArmError: a map cannot be read.
    """
    found = []
    for entry in read_manifest(data)["textures"]:
        maps, sets = entry["maps"], []
        sets.append(linear_from_srgb(_read_map(data / maps["basecolor"], 3)))
        if "arm" in maps:  # Ambient occlusion, roughness, metallic in one picture.
            sets.append(_read_map(data / maps["arm"], 3)[1:])
        else:
            sets.append(_read_map(data / maps["roughness"], 1))
            metallic = _read_map(data / maps["metallic"], 1) if "metallic" in maps else torch.zeros(1, TEXELS, TEXELS)
            sets.append(metallic)
        found.append(TextureSet(_label_of(entry["id"]), torch.cat(sets)))
    return found


def _read_map(path: Path, channels: int) -> Tensor:
    """(channels, TEXELS, TEXELS) of a picture, as it is stored."""
    buffer = oiio.ImageBuf(str(path))
    if not buffer.initialized or buffer.has_error:
        raise ArmError(f"{path}: not a readable picture; mend the texture set or remove it from the manifest")
    pixels = torch.from_numpy(buffer.get_pixels(oiio.FLOAT)).permute(2, 0, 1)
    pixels = pixels[:channels].expand(channels, -1, -1)
    return functional.interpolate(pixels[None], size=(TEXELS, TEXELS), mode="bilinear", antialias=True)[0]


def _label_of(name: str) -> int:
    """The kind of a texture set, from words in its name."""
    name = name.lower()
    return LABELS.index(next((kind for kind, words in WORDS.items() if any(word in name for word in words)), "other"))
