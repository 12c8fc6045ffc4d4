"""The "ARM" tab of the 3D view's sidebar."""

import bpy

from .notice import draw_notice
from .operators import is_running
from .preferences import BASE_PACKAGE
from .runtime import problem

_LINE = 36
"""Characters that fit into the sidebar as wide as Blender opens it."""


class ARM_PT_generate(bpy.types.Panel):
    """Views in, relightable mesh out"""

    bl_label = "Relightable 3D"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ARM"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        settings = context.scene.arm
        running = is_running()
        missing = problem()
        if missing:
            draw_notice(layout, missing, _LINE)
            layout.operator("preferences.addon_show", text="Open the Preferences").module = BASE_PACKAGE
        options = layout.column()
        options.enabled = not running
        options.use_property_split = True
        options.use_property_decorate = False
        options.prop(settings, "views_path")
        options.prop(settings, "preset")
        options.prop(settings, "quality")
        options.prop(settings, "texture_size")
        options.prop(settings, "faces")
        options.prop(settings, "seed")
        options.prop(settings, "placement")
        if running:
            state = context.window_manager.arm
            row = layout.row(align=True)
            row.progress(factor=state.fraction, text=state.message)
            row.operator("arm.cancel", text="", icon="X")
        else:
            layout.operator("arm.generate", icon="MESH_MONKEY")


def register() -> None:
    bpy.utils.register_class(ARM_PT_generate)


def unregister() -> None:
    bpy.utils.unregister_class(ARM_PT_generate)
