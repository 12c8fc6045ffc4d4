"""Which pictures the panel takes, and what is seen of them."""

from pathlib import Path

import bpy

from ..input import mask_painting, request, view_list
from ..layout import draw_choice, line_width
from .notices import draw_error
from .photograph_rows import draw_edit_mask, draw_photograph_rows


def draw_source(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings, state = context.scene.arm, context.window_manager.arm
    draw_choice(layout, settings, "source")
    row = layout.row(align=True)
    if settings.source == "FILES":
        row.prop(settings, "views_path", text="")
        listed = bool(settings.views_path) and settings.views_of == request.path_key(settings.views_path)
    else:
        row.label(text="Cameras with background images", icon="VIEW_CAMERA")
        listed = settings.views_of == request.cameras_key(context)
    row.operator("arm.look", text="", icon="FILE_REFRESH")
    if settings.source == "FILES":
        layout.operator("arm.choose_photographs", text="Photographs...", icon="FILE_IMAGE")
    if view_list.is_looking():
        layout.label(text="Reading the views", icon="SORTTIME")
    elif listed and settings.views_kind == "photographs":
        _draw_photographs(layout, settings)
    elif listed and len(settings.views) == 1:
        _draw_picture(layout, context)
    elif listed:
        _draw_views(layout, context)
    if listed:
        draw_photograph_rows(layout, context, line_width(context))
    painted = mask_painting.unsaved()
    if painted:
        layout.operator("arm.use_masks", text=f"Use {len(painted)} Painted", icon="CHECKMARK")
    draw_error(layout, context, state.views_error)
    if settings.source == "FILES" and listed and settings.views_kind == "picture":
        layout.prop(settings, "elevation")
        layout.prop(settings, "fovy")
        drawn = layout.box().column()
        drawn.prop(settings, "multiview_model", text="Zero123++")
        if settings.multiview_model:
            drawn.prop(settings, "multiview_steps")
            drawn.operator("arm.draw_views", icon="IMAGE_DATA")
    if settings.source == "FILES" and listed and settings.views_kind == "photographs":
        layout.operator("arm.solve_cameras", icon="CON_CAMERASOLVER")
    if settings.source == "CAMERAS" or (listed and settings.views_kind == "rig"):
        layout.prop(settings, "rig_distance")
        layout.prop(settings, "fovy")
    if settings.source == "CAMERAS":
        layout.operator("arm.add_cameras", text="Add Rig of Six Cameras", icon="OUTLINER_OB_CAMERA")
    elif listed and settings.views_kind in ("rig", "posed"):
        layout.operator("arm.add_cameras", text="Add Cameras of the Views", icon="OUTLINER_OB_CAMERA")


def _draw_picture(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """A single picture and its foreground, large."""
    row = layout.row()
    for icon in view_list.icons(0):
        row.template_icon(icon_value=icon, scale=5.0)
    _draw_edit_mask(layout, context, 0, "Edit Mask")


def _draw_photographs(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """The pictures, several in a row: there are many, and nothing is known of them yet."""
    name = Path(bpy.path.abspath(settings.views_path)).name
    layout.label(text=f"{len(settings.views)} photographs in {name}" if settings.views else f"The video {name}")
    grid = layout.grid_flow(row_major=True, columns=6, even_columns=True, align=True)
    for index in range(len(settings.views)):
        grid.template_icon(icon_value=view_list.icons(index)[0], scale=2.0)


def _draw_edit_mask(layout: bpy.types.UILayout, context: bpy.types.Context, index: int, text: str = "") -> None:
    """The button for the mask of a listed view, where that lies among the files that were chosen."""
    settings, seen = context.scene.arm, view_list.found(context)
    if seen is None or seen.folder is None or index >= len(seen.views):
        return
    picture, view = seen.views[index].path, settings.views[index]
    if picture.is_relative_to(seen.folder):  # Views that were made for the moment are not.
        told = f"Mask by {view.way}" if view.way else ""
        draw_edit_mask(layout, picture, seen.folder, f"{told}; doubtful: {view.doubt}" if view.doubt else told, text)


def _draw_views(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """A line for each view: tick, picture, foreground, weight, mask."""
    settings = context.scene.arm
    column = layout.column(align=True)
    column.use_property_split = False
    for index, view in enumerate(settings.views):
        row = column.row(align=True)
        row.prop(view, "use", text="")
        for icon in view_list.icons(index):
            row.template_icon(icon_value=icon, scale=2.0)
        rest = row.row(align=True)
        rest.enabled = view.use and view.sees
        if view.sees:
            rest.prop(view, "weight", text=view.name)
        else:
            rest.label(text=f"{view.name}: shows nothing", icon="INFO")
        if view.doubt:
            row.label(icon="ERROR")
        _draw_edit_mask(row, context, index)
