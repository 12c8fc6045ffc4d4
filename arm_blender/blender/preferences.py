"""The extension's preferences, and where they are found: an extension's name depends on the repository it is in."""

import bpy
from bpy.props import IntProperty

BASE_PACKAGE = __package__.rpartition(".")[0].rpartition(".")[0] or __package__.partition(".")[0]
"""`bl_ext.<repository>.arm_blender` in an extension; the package itself where it runs from its sources."""


class ARM_preferences(bpy.types.AddonPreferences):
    """Settings of this machine rather than of a scene."""

    bl_idname = BASE_PACKAGE

    threads: IntProperty(
        name="Threads",
        description="Processor threads for the networks; 0 takes all but one, so that Blender stays usable",
        default=0,
        min=0,
        soft_max=64,
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.prop(self, "threads")


def preferences() -> ARM_preferences | None:
    """The user's preferences; None where the package is not enabled as an add-on."""
    addon = bpy.context.preferences.addons.get(BASE_PACKAGE)
    return None if addon is None else addon.preferences


def register() -> None:
    bpy.utils.register_class(ARM_preferences)


def unregister() -> None:
    bpy.utils.unregister_class(ARM_preferences)
