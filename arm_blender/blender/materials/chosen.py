"""The material whose regions the panel shows, and the region of it that is chosen."""

from dataclasses import replace
from typing import Any

import bpy

from ...knobs.finishes import Finish
from ..asset.finish_nodes import can_be_set, finishes, set_finish, set_finishes
from ..asset.regions import KnownRegion, known_regions
from ..asset.view_switch import show


def active_material(context: bpy.types.Context) -> bpy.types.Material | None:
    """That of the active object, if it is one of ours."""
    shown = context.object
    material = shown.active_material if shown is not None and shown.type == "MESH" else None
    return material if material is not None and "arm_maps" in material else None


def chosen_region(material: bpy.types.Material) -> KnownRegion | None:
    """What is known of the chosen region: of the first where that number is none of the material's."""
    known = known_regions(material).regions
    return next((region for region in known if region.number == material.arm_region), known[0] if known else None)


def shown_value(material: bpy.types.Material, name: str) -> float:
    """What a slider stands at: "roughness" or "metallic" of the chosen region."""
    region = chosen_region(material)
    return 0.0 if region is None else getattr(finishes(material).get(region.number, region), name)


def set_value(material: bpy.types.Material, name: str, value: float) -> None:
    """Set "roughness" or "metallic" of the chosen region; the other becomes what its slider stands at."""
    region = chosen_region(material)
    if region is not None and can_be_set(material):
        changed: dict[str, Any] = {name: value}
        before = finishes(material).get(region.number, Finish(region.roughness, region.metallic))
        give(material, region.number, replace(before, **changed))


def give(material: bpy.types.Material, number: int, finish: Finish | None) -> None:
    """Set a region, or reset it, and have what the material shows follow."""
    set_finish(material, number, finish)
    show(material, material.arm_view)


def reset_all(material: bpy.types.Material) -> None:
    """All regions as predicted, and what the material shows follows."""
    set_finishes(material, {})
    show(material, material.arm_view)


def may_be_set(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Whether the active object has regions that can be set; the operator says what is missing."""
    material = active_material(context)
    if material is None:
        operator.poll_message_set("Select a generated object")
    elif not known_regions(material).regions:
        operator.poll_message_set("This object has no regions; Regenerate Appearance finds them")
    elif material.library is not None:
        operator.poll_message_set("The material is linked from another file; make it local first")
    elif not can_be_set(material):
        operator.poll_message_set("The material has lost its Principled BSDF or its image of regions")
    else:
        return True
    return False
