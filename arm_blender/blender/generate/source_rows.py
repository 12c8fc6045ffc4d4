"""Which pictures the panel takes, and what is seen of them."""

from pathlib import Path

import bpy

from ..input import mask_painting, view_list
from ..layout import draw_choice, draw_notice, line_width
from .notices import draw_error
from .photograph_rows import draw_edit_mask, draw_photograph_rows


def draw_source(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Where the pictures are, what was found there, and what is still to be said of them."""
    settings, listed = context.scene.arm, view_list.is_listed(context)
    draw_choice(layout, settings, "source")
    row = layout.row(align=True)
    if settings.source == "FILES":
        row.prop(settings, "views_path", text="")
    else:
        row.label(text="Cameras with background images", icon="VIEW_CAMERA")
    row.operator("arm.look", text="", icon="FILE_REFRESH")
    if settings.source == "FILES":
        layout.operator("arm.choose_photographs", text="Photographs...", icon="FILE_IMAGE")
    _draw_first_step(layout, context)
    _draw_seen(layout, context, listed)
    painted = mask_painting.unsaved()
    if painted:
        layout.operator("arm.use_masks", text=f"Use {len(painted)} Painted Masks", icon="CHECKMARK")
    draw_error(layout, context, context.window_manager.arm.views_error)
    if settings.source == "FILES":
        _draw_told_of_files(layout, settings, settings.views_kind if listed else "")
    else:
        layout.prop(settings, "rig_distance")
        layout.prop(settings, "fovy")
        layout.operator("arm.add_cameras", text="Add Rig of Six Cameras", icon="OUTLINER_OB_CAMERA")


def _draw_first_step(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What to do where no pictures are chosen, and the example for who has none."""
    settings = context.scene.arm
    if settings.source == "FILES":
        if settings.views_path:
            return
        step = "Choose a picture, a folder of views, or photographs of one object; or try the example"
    else:
        if any(len(camera.background_images) for camera in bpy.data.cameras):
            return
        step = "Give the scene's cameras background images, in Camera Properties; or try the example"
    draw_notice(layout, step, line_width(context), icon="INFO")
    layout.operator("arm.load_example", text="Example", icon="IMAGE_DATA")


def _draw_seen(layout: bpy.types.UILayout, context: bpy.types.Context, listed: bool) -> None:
    """The pictures that were found."""
    settings = context.scene.arm
    if view_list.is_looking():
        layout.label(text="Reading the views", icon="SORTTIME")
    elif listed and settings.views_kind == "photographs":
        _draw_photographs(layout, context)
    elif listed and len(settings.views) == 1:
        _draw_picture(layout, context)
    elif listed:
        _draw_views(layout, context)
    if listed and not view_list.is_looking() and view_list.found(context) is None:  # A file that was opened.
        draw_notice(layout, "Press Refresh, above, to see the pictures", line_width(context), icon="INFO")
    if listed:
        draw_photograph_rows(layout, context, line_width(context))


def _draw_told_of_files(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup, kind: str) -> None:
    """What files of a kind do not say themselves, and what can be made of them."""
    if kind == "picture":
        layout.prop(settings, "elevation")
    elif kind == "rig":
        layout.prop(settings, "rig_distance")
    if kind in ("picture", "rig"):
        layout.prop(settings, "fovy")
    if kind == "picture":
        drawn = layout.box().column()
        drawn.prop(settings, "multiview_model", text="Zero123++")
        if settings.multiview_model:
            drawn.prop(settings, "multiview_steps")
            drawn.operator("arm.draw_views", icon="IMAGE_DATA")
    elif kind == "photographs":
        layout.operator("arm.solve_cameras", icon="CON_CAMERASOLVER")
    elif kind in ("rig", "posed"):
        layout.operator("arm.add_cameras", text="Add Cameras of the Views", icon="OUTLINER_OB_CAMERA")


def _draw_picture(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """A single picture and its foreground, large."""
    row = layout.row()
    for icon in view_list.icons(context, 0):
        row.template_icon(icon_value=icon, scale=5.0)
    _draw_edit_mask(layout, context, 0, "Edit Mask")


def _draw_photographs(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The pictures, several in a row: there are many, and nothing is known of them yet."""
    settings = context.scene.arm
    name = Path(bpy.path.abspath(settings.views_path)).name
    layout.label(text=f"{len(settings.views)} photographs in {name}" if settings.views else f"The video {name}")
    grid = layout.grid_flow(row_major=True, columns=6, even_columns=True, align=True)
    for index in range(len(settings.views)):
        grid.template_icon(icon_value=view_list.icons(context, index)[0], scale=2.0)


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
        for icon in view_list.icons(context, index):
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
