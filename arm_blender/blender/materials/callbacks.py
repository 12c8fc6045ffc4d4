"""What the properties of regions call.

Nothing here holds bpy: Blender 4.2 lets go neither of a property's callback nor, through it, of its module. As a Python
module it crashes at exit where that one holds bpy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import bpy


def region_chosen(material: bpy.types.Material, _context: bpy.types.Context) -> None:
    """The picture of the regions follows."""
    from ..asset.view_switch import show

    show(material, material.arm_view)


def get_roughness(material: bpy.types.Material) -> float:
    """Of the chosen region: what it is set to, else what was predicted of it on average."""
    from .chosen import shown_value

    return shown_value(material, "roughness")


def set_roughness(material: bpy.types.Material, value: float) -> None:
    """Set the chosen region's."""
    from .chosen import set_value

    set_value(material, "roughness", value)


def get_metallic(material: bpy.types.Material) -> float:
    """As `get_roughness`."""
    from .chosen import shown_value

    return shown_value(material, "metallic")


def set_metallic(material: bpy.types.Material, value: float) -> None:
    """As `set_roughness`."""
    from .chosen import set_value

    set_value(material, "metallic", value)
