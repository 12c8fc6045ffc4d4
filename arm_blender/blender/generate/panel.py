"""The "ARM" tab of the 3D view's sidebar."""

from pathlib import Path

import bpy

from ...asset_record import AssetRecord
from ...errors import ArmError
from ...quality_levels import PRESET, measured_levels
from ..input import mask_painting, request, view_list
from ..layout import InSidebar, draw_notice
from ..setup import background, runtime
from ..setup.stored import BASE_PACKAGE
from .matting_operator import wants_matting
from .operators import is_running
from .photograph_rows import draw_edit_mask, draw_photograph_rows

NO_FOREGROUND = ": no foreground found"
"""Follows the picture in an error that a painted mask mends."""

_CHARACTER = 7.0
"""Pixels of a character of Blender's own font, about, at a scale of 1."""


class ARM_PT_generate(InSidebar, bpy.types.Panel):
    """Views in, relightable mesh out"""

    bl_label = "Relightable 3D"

    def draw(self, context: bpy.types.Context) -> None:
        settings, state = context.scene.arm, context.window_manager.arm
        missing = runtime.problem()
        if missing:
            _draw_error(self.layout, context, missing)
            self.layout.operator("preferences.addon_show", text="Open the Preferences").module = BASE_PACKAGE
        _draw_setup(self.layout, context)
        options = self.layout.column()
        options.enabled = not is_running()
        options.use_property_split = True
        options.use_property_decorate = False
        _draw_source(options, context)
        options.separator()
        _draw_choice(options, settings, "shape")
        if settings.shape == "MESH":
            _draw_own_mesh(options, context)
        options.separator()
        options.prop(settings, "preset")
        options.prop(settings, "quality")
        _draw_measured(options, settings)
        options.prop(settings, "texture_size")
        if settings.shape == "NETWORK":
            options.prop(settings, "faces")
            options.prop(settings, "normal_map")
        options.prop(settings, "seed")
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
                _draw_error(self.layout, context, state.error)


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
        options.prop(context.scene.arm, "own_weights")
        options.prop(context.scene.arm, "finish")


class ARM_PT_result(InSidebar, bpy.types.Panel):
    """What the active result was made with, what it shows, and its appearance made anew"""

    bl_label = "Result"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and "arm_settings" in context.object

    def draw(self, context: bpy.types.Context) -> None:
        layout, shown = self.layout, context.object
        if shown.active_material is not None:
            layout.prop(shown.active_material, "arm_view")
        try:
            kept = request.stored_record(shown)
        except ArmError as error:
            _draw_error(layout, context, str(error))
            return
        for why in (kept.report or {}).get("doubts", ()):
            _draw_error(layout, context, f"Doubtful: {why}")
        _draw_report(layout, kept)
        if kept.frame is not None:  # Earlier versions of the command line kept neither frame nor views.
            layout.operator("arm.regenerate", icon="FILE_REFRESH")
        layout.operator("arm.recall", icon="LOOP_BACK")


def _draw_source(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings, state = context.scene.arm, context.window_manager.arm
    _draw_choice(layout, settings, "source")
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
        draw_photograph_rows(layout, context, _line(context))
    painted = mask_painting.unsaved()
    if painted:
        layout.operator("arm.use_masks", text=f"Use {len(painted)} Painted", icon="CHECKMARK")
    _draw_error(layout, context, state.views_error)
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


def _draw_setup(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What is being installed, or why it was not."""
    running = background.progress()
    if running is not None:
        row = layout.row(align=True)
        row.progress(factor=running[0], text=running[1])
        row.operator("arm.cancel_setup", text="", icon="X")
    else:
        _draw_error(layout, context, background.error())


def _draw_choice(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup, name: str) -> None:
    """Alternatives side by side, without a label that would leave them no room."""
    row = layout.row()
    row.use_property_split = False
    row.prop(settings, name, expand=True)


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


def _draw_own_mesh(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    chosen = context.object
    if chosen is None or chosen.type != "MESH":
        layout.label(text="Select a mesh", icon="ERROR")
    elif context.mode != "OBJECT":
        layout.label(text=f"{chosen.name}: go back to Object Mode", icon="ERROR")
    else:
        uvs = "its UVs" if len(chosen.data.uv_layers) else "new UVs"
        layout.label(text=f"{chosen.name}, {uvs}", icon="MESH_DATA")


def _draw_measured(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """What the quality takes and gives, as far as it was measured."""
    if settings.preset != PRESET:
        return
    level = measured_levels()[settings.quality]
    own_mesh = settings.shape == "MESH"
    seconds = sum(value for stage, value in level.seconds.items() if stage != "shape" or not own_mesh)
    column = layout.column(align=True)
    column.active = False
    column.label(text=f"Measured: {seconds:.0f} s", icon="INFO")
    if not own_mesh:
        column.label(text=f"Chamfer distance {level.chamfer:.3f}", icon="BLANK1")
    column.label(text=f"Color {level.psnr:.1f} dB", icon="BLANK1")


def _draw_report(layout: bpy.types.UILayout, kept: AssetRecord) -> None:
    chosen, report = kept.chosen, kept.report or {}
    column = layout.column(align=True)
    column.label(text=f"{chosen['preset']}, {chosen['quality']}, seed {chosen['seed']}")
    if chosen["weights_folder"] is not None:
        column.label(text=f"weights of {chosen['weights_folder'].name}")
    if report.get("faces") is not None:
        column.label(text=f"{report['faces']:,} faces, texture {report['texture_size']}")
    for stage, seconds in report.get("seconds", {}).items():
        column.label(text=f"{stage}: {seconds:.1f} s")


def _draw_error(layout: bpy.types.UILayout, context: bpy.types.Context, message: str) -> None:
    """One message, as many lines as the sidebar needs for it."""
    if not message:
        return
    box = layout.box()
    box.alert = True
    draw_notice(box, message, _line(context))
    box.alert = False
    if wants_matting(message) and not runtime.has_matting():
        box.operator("arm.get_matting_model", icon="IMPORT")
    picture = Path(message.partition(NO_FOREGROUND)[0])
    if NO_FOREGROUND in message and picture.is_absolute():  # Else it is the name of a camera.
        chosen = Path(bpy.path.abspath(context.scene.arm.views_path))
        root = chosen if chosen in picture.parents else picture.parent
        draw_edit_mask(box, picture, root, message, "Paint Its Mask")


def _line(context: bpy.types.Context) -> int:
    """Characters that fit into the sidebar."""
    scale = context.preferences.system.ui_scale
    return max(20, int(context.region.width / (_CHARACTER * scale)) - 6)


classes = (ARM_PT_generate, ARM_PT_advanced, ARM_PT_result)

register, unregister = bpy.utils.register_classes_factory(classes)
