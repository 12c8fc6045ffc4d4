"""A sentence of the program in a panel: Blender does not break a label, it cuts the middle out of it."""

import textwrap

import bpy


def draw_notice(layout: bpy.types.UILayout, text: str, width: int, icon: str = "ERROR") -> None:
    """Show `text` in lines of at most `width` characters, an icon before the first."""
    column = layout.column(align=True)
    for index, line in enumerate(textwrap.wrap(text, width)):
        column.label(text=line, icon="BLANK1" if index else icon)
