"""The parts "Relight" and "Export" of the "ARM" tab."""

import bpy

from ..asset.predicted_light import has_light
from ..layout import InSidebar, draw_notice, line_width
from .callbacks import FROM_FILE
from .operators import PICTURE, can_be_relit, lacks_saved_file


class ARM_PT_relight(InSidebar, bpy.types.Panel):
    """The active object under other lights"""

    bl_label = "Relight"
    bl_order = 10

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.arm_relight
        if not can_be_relit(context.active_object):
            draw_notice(layout, "Generate an object, or select a mesh, to relight it", line_width(context), "INFO")
        light = layout.column(align=True)
        light.prop(settings, "environment")
        if settings.environment == FROM_FILE:
            light.prop(settings, "environment_file")
        light.prop(settings, "rotation")
        light.operator("arm.light_scene", icon="WORLD")
        layout.prop(settings, "compare")
        if settings.compare:
            layout.prop(settings, "second")
            if settings.second == FROM_FILE:
                layout.prop(settings, "second_file")
        render = layout.column(align=True)
        render.prop(settings, "engine")
        render.prop(settings, "resolution")
        render.prop(settings, "samples")
        layout.prop(settings, "output")
        if lacks_saved_file(settings.output):
            draw_notice(layout, "Save the file, or choose another folder", line_width(context), "INFO")
        layout.operator("arm.relight", text="Render Still", icon="RENDER_STILL").what = "STILL"
        if has_light(context.active_object):
            compared = layout.column(align=True)
            compared.prop(settings, "view")
            compared.operator("arm.compare_view", icon="ZOOM_SELECTED")
        image = bpy.data.images.get(PICTURE)
        if image is not None and image.preview is not None:
            layout.template_icon(image.preview.icon_id, scale=8.0)


class ARM_PT_relight_sequence(InSidebar, bpy.types.Panel):
    """One full turn, as pictures and as a video"""

    bl_label = "Sequence"
    bl_parent_id = "ARM_PT_relight"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.arm_relight
        layout.prop(settings, "turning")
        layout.prop(settings, "turntable")
        layout.prop(settings, "video")
        if settings.video:
            layout.prop(settings, "frames_per_second")
        layout.operator("arm.relight", text="Render Sequence", icon="RENDER_ANIMATION").what = "SEQUENCE"


class ARM_PT_export(InSidebar, bpy.types.Panel):
    """The active object for other programs"""

    bl_label = "Export"
    bl_order = 11
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        active = context.active_object
        if active is None or active.type != "MESH":
            draw_notice(self.layout, "Generate an object, or select a mesh, to export it", line_width(context), "INFO")
        self.layout.operator("arm.export", text="Export...", icon="EXPORT")


classes = (ARM_PT_relight, ARM_PT_relight_sequence, ARM_PT_export)

register, unregister = bpy.utils.register_classes_factory(classes)
