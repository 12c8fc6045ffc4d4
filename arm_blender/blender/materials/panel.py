"""The part "Materials" of the "ARM" tab."""

import bpy

from ...knobs.finishes import Finish
from ..asset.finish_nodes import can_be_set, finishes
from ..asset.regions import KnownRegion, known_regions
from ..layout import InSidebar, draw_notice, line_width
from .chosen import active_material, chosen_region
from .presets import title_of
from .swatches import swatch


class ARM_PT_materials(InSidebar, bpy.types.Panel):
    """The regions of the active object, and the finish of each"""

    bl_label = "Materials"
    bl_order = 5

    def draw(self, context: bpy.types.Context) -> None:
        layout, material = self.layout, active_material(context)
        if material is None:
            step = "Generate an object, or select one, to set what its parts are made of"
            draw_notice(layout, step, line_width(context), "INFO")
            return
        chosen = chosen_region(material)
        if chosen is None:
            step = "This object has no regions; Regenerate Appearance finds them"
            draw_notice(layout, step, line_width(context), "INFO")
            return
        given = finishes(material)
        rows = layout.column(align=True)
        for region in known_regions(material).regions:
            _draw_row(rows, region, given.get(region.number), region == chosen)
        layout.operator("arm.pick_region", icon="EYEDROPPER")
        layout.use_property_split = True
        layout.use_property_decorate = False
        sliders = layout.column(align=True)
        sliders.enabled = can_be_set(material) and material.library is None
        sliders.prop(material, "arm_region_roughness", text="Roughness", slider=True)
        sliders.prop(material, "arm_region_metallic", text="Metallic", slider=True)
        title = title_of(given[chosen.number]) if chosen.number in given else "Finish"
        layout.operator_menu_enum("arm.set_finish", "finish", text=title, icon="MATERIAL")
        resets = layout.column(align=True)
        resets.operator("arm.reset_finish", icon="LOOP_BACK")
        resets.operator("arm.reset_finishes")
        if given:  # Blender's own exporters write the prediction.
            layout.label(text="For other programs: Export, below", icon="INFO")


def _draw_row(rows: bpy.types.UILayout, region: KnownRegion, finish: Finish | None, chosen: bool) -> None:
    """One region: swatch and number, share of the surface, what it is set to."""
    row = rows.row(align=True)
    text = f"{region.number}   {_percent(region.area)}   {title_of(finish)}"
    button = row.operator("arm.choose_region", text=text, icon_value=swatch(region.swatch), depress=chosen)
    button.number = region.number
    reset = row.row(align=True)
    reset.enabled = finish is not None
    reset.operator("arm.reset_finish", text="", icon="LOOP_BACK").number = region.number


def _percent(area: float) -> str:
    return "<1 %" if area < 0.01 else f"{100.0 * area:.0f} %"


register, unregister = bpy.utils.register_classes_factory((ARM_PT_materials,))
