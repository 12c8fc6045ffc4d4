"""What panels and preferences have in common: a sentence shown whole, and being drawn anew."""

import textwrap

import bpy


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


def redraw_sidebars(context: bpy.types.Context) -> None:
    """Ask every 3D view to draw its sidebar anew, and not the scene, which may take long."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions if area.type == "VIEW_3D" else ():
                if region.type == "UI":
                    region.tag_redraw()
