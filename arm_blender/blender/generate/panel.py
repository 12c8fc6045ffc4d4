"""The "ARM" tab of the 3D view's sidebar."""

import bpy

from ...quality_levels import PRESET, measured_levels
from ..layout import InSidebar, draw_choice, draw_notice, line_width, title_of
from ..setup import background, runtime
from ..setup.stored import BASE_PACKAGE
from .notices import draw_error
from .operators import is_running
from .source_rows import draw_source


class ARM_PT_generate(InSidebar, bpy.types.Panel):
    """Views in, relightable mesh out"""

    bl_label = "Relightable 3D"

    def draw(self, context: bpy.types.Context) -> None:
        settings, state = context.scene.arm, context.window_manager.arm
        missing = runtime.problem()
        if missing:
            draw_error(self.layout, context, missing)
            self.layout.operator("preferences.addon_show", text="Open the Preferences").module = BASE_PACKAGE
        _draw_setup(self.layout, context)
        options = self.layout.column()
        options.enabled = not is_running()
        options.use_property_split = True
        options.use_property_decorate = False
        draw_source(options, context)
        options.separator()
        draw_choice(options, settings, "shape")
        if settings.shape == "MESH":
            _draw_own_mesh(options, context)
        options.separator()
        options.prop(settings, "quality")
        _draw_measured(options, context)
        options.prop(settings, "texture_size")
        if settings.shape == "NETWORK":
            options.prop(settings, "faces")
            options.prop(settings, "normal_map")
        options.separator()
        if settings.shape == "NETWORK":
            options.prop(settings, "placement")
            if settings.placement == "ground":
                options.prop(settings, "size")
        options.prop(settings, "as_asset")
        self.layout.separator()
        if is_running():
            row = self.layout.row(align=True)
            row.progress(factor=state.fraction, text=state.message)
            row.operator("arm.cancel", text="", icon="X")
            if state.time:
                self.layout.label(text=state.time, icon="TIME")
        else:
            row = self.layout.row()
            row.scale_y = 1.5
            row.operator("arm.generate", icon="MESH_MONKEY")
            if state.error != state.views_error:  # That stands beside the views already.
                draw_error(self.layout, context, state.error)


class ARM_PT_advanced(InSidebar, bpy.types.Panel):
    """What few need"""

    bl_label = "Advanced"
    bl_parent_id = "ARM_PT_generate"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        options = self.layout.column()
        options.enabled = not is_running()
        options.use_property_split = True
        options.use_property_decorate = False
        for name in ("preset", "own_weights", "finish", "seed"):
            options.prop(context.scene.arm, name)


def _draw_setup(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What is being installed, or why it was not."""
    running = background.progress()
    if running is not None:
        row = layout.row(align=True)
        row.progress(factor=running[0], text=running[1])
        row.operator("arm.cancel_setup", text="", icon="X")
    else:
        draw_error(layout, context, background.error())


def _draw_own_mesh(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    chosen = context.object
    if chosen is None or chosen.type != "MESH":
        layout.label(text="Select a mesh", icon="ERROR")
    elif context.mode != "OBJECT":
        layout.label(text=f"{chosen.name}: go back to Object Mode", icon="ERROR")
    else:
        uvs = "its UVs" if len(chosen.data.uv_layers) else "new UVs"
        layout.label(text=f"{chosen.name}, {uvs}", icon="MESH_DATA")


def _draw_measured(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What the quality takes and gives, as far as it was measured."""
    settings = context.scene.arm
    column = layout.column()
    column.active = False
    if settings.preset != PRESET:
        told = f"Networks: {title_of(settings, 'preset')}, as set in Advanced"
    else:
        level = measured_levels()[settings.quality]
        if settings.shape == "MESH":
            seconds = sum(value for stage, value in level.seconds.items() if stage != "shape")
            close = f"colors off by {level.off_in_color:.0%}"
        else:
            seconds = sum(level.seconds.values())
            close = f"shape off by {level.off_in_shape:.0%} of its size, colors by {level.off_in_color:.0%}"
        told = f"About {seconds:.0f} seconds on two processor cores; {close}"
    draw_notice(column, told, line_width(context), icon="INFO")


classes = (ARM_PT_generate, ARM_PT_advanced)

register, unregister = bpy.utils.register_classes_factory(classes)
