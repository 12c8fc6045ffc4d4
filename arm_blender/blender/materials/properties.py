"""What a material knows of the artist's choice, and the sliders of the chosen region."""

import bpy
from bpy.props import FloatProperty, IntProperty

from ...knobs.finishes import MOST_REGIONS
from .callbacks import get_metallic, get_roughness, region_chosen, set_metallic, set_roughness


def register() -> None:
    material = bpy.types.Material
    material.arm_region = IntProperty(
        name="Region",
        description="The one whose finish is shown and set",
        default=1,
        min=1,
        max=MOST_REGIONS,
        update=region_chosen,
    )
    material.arm_region_roughness = FloatProperty(
        name="Roughness",
        description="0 mirrors, 1 is matt. Until the region is set it shows the predicted average",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        precision=2,
        get=get_roughness,
        set=set_roughness,
    )
    material.arm_region_metallic = FloatProperty(
        name="Metallic",
        description="1 is bare metal, 0 anything else, even painted metal; between lies metal under dust or rust",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        precision=2,
        get=get_metallic,
        set=set_metallic,
    )


def unregister() -> None:
    for name in ("arm_region", "arm_region_roughness", "arm_region_metallic"):
        delattr(bpy.types.Material, name)
