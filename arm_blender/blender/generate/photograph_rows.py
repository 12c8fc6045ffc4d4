"""The list of photographs: what became of each, and the mask of the chosen one."""

from pathlib import Path

import bpy

from ..input import view_list
from ..layout import draw_notice

_ROWS = 6
"""Of the list, before it scrolls."""


class ARM_UL_photographs(bpy.types.UIList):
    """A line for each photograph: whether it is a view, and why not"""

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: bpy.types.AnyType,
        item: bpy.types.AnyType,
        icon: int,
        active_data: bpy.types.AnyType,
        active_property: str,
        index: int = 0,
        flt_flag: int = 0,
    ) -> None:
        row = layout.split(factor=0.5)
        row.label(text=Path(item.name).stem, icon=icon_of(item))  # All have one suffix, and little room.
        row.label(text=item.short)


def icon_of(row: bpy.types.PropertyGroup) -> str:
    """A view, one whose mask is doubtful, a picture that is not needed or does not do, or one without a camera."""
    if row.view:
        return "ERROR" if row.doubtful else "CHECKMARK"
    return "REMOVE" if row.registered else "X"


def draw_photograph_rows(layout: bpy.types.UILayout, context: bpy.types.Context, width: int) -> None:
    """The list, and all that is known of the chosen photograph in lines of at most `width` characters."""
    settings, seen = context.scene.arm, view_list.found(context)
    count = len(settings.photographs)
    if not count:
        return
    views = sum(bool(row.view) for row in settings.photographs)
    layout.label(text=f"{views} of {count} photographs are views", icon="IMAGE_DATA")
    layout.template_list("ARM_UL_photographs", "", settings, "photographs", settings, "photograph", rows=_ROWS)
    chosen = settings.photographs[min(settings.photograph, count - 1)]
    draw_notice(layout, f"{chosen.name}: {chosen.whole}", width, icon="INFO")
    if chosen.picture and seen is not None and seen.folder is not None:
        draw_edit_mask(layout, seen.folder / chosen.picture, seen.folder, chosen.whole, "Edit Mask")


def draw_edit_mask(layout: bpy.types.UILayout, picture: Path, root: Path, told: str, text: str = "") -> None:
    """The button that opens the mask of a picture; `told` is what its tooltip begins with."""
    button = layout.operator("arm.edit_mask", text=text, icon="BRUSH_DATA")
    button.picture, button.root, button.told = str(picture), str(root), told


register, unregister = bpy.utils.register_classes_factory((ARM_UL_photographs,))
