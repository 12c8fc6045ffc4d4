"""What the property that names the views calls.

Nothing here holds bpy: Blender 4.2 lets go neither of a property's callback nor, through it, of its module. As a Python
module it crashes at exit where that one holds bpy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import bpy


def views_changed(_settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Other views are chosen: they are read soon."""
    from . import view_list

    view_list.look_soon(context)
