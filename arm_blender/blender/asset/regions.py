"""The regions of a material: the image that says which texel is of which, and what is known of each."""

import json
from dataclasses import asdict, dataclass

import bpy

from ...knobs.finishes import MOST_REGIONS
from ..compat import shader_tree

NODE = "Regions"
"""The node of the image; linked to nothing but the table of finishes, where something is set."""

STEPS = MOST_REGIONS + 1
"""Greys of the image: that of a region is the middle of its step, (number + 0.5) / STEPS. Number 0 is of no region."""

_KNOWN = "arm_regions"
"""Custom property of the material: `KnownRegions` as JSON."""


@dataclass(frozen=True)
class KnownRegion:
    """What is known of a region.

    Attributes:
        number: 1 is the largest.
        area: its share of the surface, in [0, 1].
        swatch: its mean albedo, linear Rec.709.
        roughness, metallic: predicted means, in [0, 1].
    """

    number: int
    area: float
    swatch: tuple[float, float, float]
    roughness: float
    metallic: float


@dataclass(frozen=True)
class KnownRegions:
    """What is known of the regions of a material; nothing of one from before there were any.

    Attributes:
        light: of the views, linear Rec.709 > 0, as in `structures.Regions`.
    """

    regions: tuple[KnownRegion, ...] = ()
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)


def number_of(grey: float) -> int:
    """The region of a grey of the image."""
    return min(int(grey * STEPS), MOST_REGIONS)


def regions_image(material: bpy.types.Material) -> bpy.types.Image | None:
    """The image, where the material has one."""
    node = shader_tree(material).nodes.get(NODE)
    return node.image if node is not None and node.type == "TEX_IMAGE" else None


def known_regions(material: bpy.types.Material) -> KnownRegions:
    """What the material carries of them."""
    if _KNOWN not in material:
        return KnownRegions()
    kept = json.loads(material[_KNOWN])
    found = (KnownRegion(**entry | {"swatch": tuple(entry["swatch"])}) for entry in kept["regions"])
    return KnownRegions(tuple(found), tuple(kept["light"]))


def keep_regions(material: bpy.types.Material, known: KnownRegions) -> None:
    """Have the material carry what is known."""
    material[_KNOWN] = json.dumps(asdict(known))


def make_steps(ramp: bpy.types.ColorRamp) -> bpy.types.bpy_prop_collection:
    """Have a new colour ramp give each region of the image a colour of its own: black so far.

    Returns:
        the steps; a region's number is its index.
    """
    ramp.interpolation = "CONSTANT"
    ramp.elements[1].position = 1.0 / STEPS
    for number in range(2, STEPS):
        ramp.elements.new(number / STEPS)
    for element in ramp.elements:
        element.color = (0.0, 0.0, 0.0, 1.0)
    return ramp.elements
