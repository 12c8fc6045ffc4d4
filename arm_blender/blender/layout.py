"""What panels and preferences have in common: a sentence shown whole, and being drawn anew."""

import textwrap

import bpy

_CHARACTER = 7.0
"""Pixels of a character of Blender's own font, about, at a scale of 1."""


class InSidebar:
    """Where our panels are: the "ARM" tab of the 3D view's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "ARM"


def draw_notice(layout: bpy.types.UILayout, text: str, width: int, icon: str = "ERROR") -> None:
    """Show `text` in lines of at most `width` characters, an icon before the first.

    Blender does not break a label, it cuts the middle out of it.
    """
    column = layout.column(align=True)
    for index, line in enumerate(textwrap.wrap(text, width)):
        column.label(text=line, icon="BLANK1" if index else icon)


def line_width(context: bpy.types.Context) -> int:
    """Characters that fit into the sidebar."""
    scale = context.preferences.system.ui_scale
    return max(20, int(context.region.width / (_CHARACTER * scale)) - 6)


def draw_choice(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup, name: str) -> None:
    """Alternatives side by side, without a label that would leave them no room."""
    row = layout.row()
    row.use_property_split = False
    row.prop(settings, name, expand=True)


def title_of(settings: bpy.types.PropertyGroup, name: str) -> str:
    """What the panel calls the chosen item of an enumeration."""
    return str(settings.bl_rna.properties[name].enum_items[getattr(settings, name)].name)


def redraw_sidebars(context: bpy.types.Context) -> None:
    """Ask every 3D view to draw its sidebar anew, and not the scene, which may take long."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions if area.type == "VIEW_3D" else ():
                if region.type == "UI":
                    region.tag_redraw()
