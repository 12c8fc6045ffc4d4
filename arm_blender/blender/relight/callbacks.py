"""What the properties of relighting call.

Nothing here holds bpy: Blender 4.2 lets go neither of a property's callback nor, through it, of its module. As a Python
module it crashes at exit where that one holds bpy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import bpy

FROM_FILE = "FILE"
"""The choice of a file of the user's own."""

FROM_VIEWS = "VIEWS"
"""The choice of the light that was predicted from the views of the active object."""

_shown: list[tuple[str, str, str]] = []
"""What the menus show now: Blender keeps no reference to the words that it is given."""


def environments(_settings: bpy.types.PropertyGroup, _context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    """The environments to choose from, as an enumeration's items."""
    from .environments import shipped_environments

    shipped = [(name, name.capitalize(), "Comes with Blender") for name in shipped_environments()]
    # At the end: a choice is stored as its place.
    views = (FROM_VIEWS, "Light of the Views", "As it was predicted from the views of the active object")
    _shown[:] = [*shipped, (FROM_FILE, "File", "An environment map of your own"), views]
    return _shown


def environment_turned(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """The scene's own light follows at once, where it is of ours."""
    import math

    from ..asset.studio import turn_environment

    if context.scene.world is not None:
        turn_environment(context.scene.world, math.degrees(settings.rotation))
