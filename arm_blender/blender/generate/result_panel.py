"""The part "Result" of the "ARM" tab."""

import bpy

from ...asset_record import AssetRecord
from ...errors import ArmError
from ...quality_levels import PRESET
from ..input import request
from ..layout import InSidebar, draw_notice, line_width
from .hiding import hides
from .notices import draw_error
from .remaining import clock


class ARM_PT_result(InSidebar, bpy.types.Panel):
    """What the active result was made with, what it shows, and its appearance made anew"""

    bl_label = "Result"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and "arm_settings" in context.object

    def draw(self, context: bpy.types.Context) -> None:
        layout, shown = self.layout, context.object
        _draw_what_hides(layout, context)
        if shown.active_material is not None:
            layout.prop(shown.active_material, "arm_view")
        try:
            kept = request.stored_record(shown)
        except ArmError as error:
            draw_error(layout, context, str(error))
            return
        for why in (kept.report or {}).get("doubts", ()):
            draw_error(layout, context, f"Doubtful: {why}")
        _draw_report(layout, kept)
        if kept.frame is not None:  # Earlier versions of the command line kept neither frame nor views.
            layout.operator("arm.regenerate", icon="FILE_REFRESH")
        layout.operator("arm.recall", icon="LOOP_BACK")


def _draw_what_hides(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Why a result may not be seen, or not its materials, and the button that shows them."""
    shown, state, space = context.object, context.window_manager.arm, context.space_data
    hider = bpy.data.objects.get(state.hidden_by) if state.newest == shown.name else None
    if hider is not None and space.local_view is None and hides(hider, shown):
        draw_notice(layout, f"{hider.name} hides it", line_width(context))
        layout.operator("view3d.localview", text="Show It Alone", icon="HIDE_OFF")
    shading = space.shading
    if shading.type in ("WIREFRAME", "SOLID") and shading.color_type != "TEXTURE":
        draw_notice(layout, "This shading shows no materials", line_width(context), icon="INFO")
        layout.prop_enum(shading, "type", "MATERIAL")


def _draw_report(layout: bpy.types.UILayout, kept: AssetRecord) -> None:
    """What an artist asks of a result; report.json has the rest."""
    chosen, report = kept.chosen, kept.report or {}
    column = layout.column(align=True)
    column.label(text=f"{chosen['quality'].title()} quality, seed {chosen['seed']}")
    if chosen["preset"] != PRESET:
        column.label(text=f"Networks of {chosen['preset']}")
    if chosen["weights_folder"] is not None:
        column.label(text=f"Weights of {chosen['weights_folder'].name}")
    if report.get("faces") is not None:
        column.label(text=f"{report['faces']:,} faces, texture of {report['texture_size']} pixels")
    if report.get("seconds"):
        column.label(text=f"Made in {clock(sum(report['seconds'].values()))}")


register, unregister = bpy.utils.register_classes_factory((ARM_PT_result,))
