"""How the preferences look: device and threads, where libraries come from, folders, and the networks' weights."""

import bpy

from ...machine import libraries
from ...machine.library_install import lock_of
from ..layout import draw_notice
from . import background, runtime
from .operators import NO_LIST, OFFLINE, weights
from .stored import user_folder

_LINE = 64
"""Characters that fit into the preferences as wide as Blender opens them."""

_ICONS = {"whole": "CHECKMARK", "damaged": "ERROR", "not installed": "REMOVE"}


def draw_setup(layout: bpy.types.UILayout, chosen: bpy.types.AddonPreferences) -> None:
    """Fill the preferences of the add-on."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    _draw_work(layout)  # On top, where it is seen whichever button was pressed.
    layout.prop(chosen, "device")
    layout.prop(chosen, "threads")
    _draw_torch(layout.box(), chosen)
    _draw_photos(layout.box())
    _draw_matting(layout.box())
    _draw_multiview(layout.box(), chosen)
    folders = layout.box()
    for kind in ("weights", "cache"):
        folders.prop(chosen, f"{kind}_folder")
        if not getattr(chosen, f"{kind}_folder"):
            folders.label(text=str(user_folder(kind)), icon="BLANK1")
    _draw_weights(layout.box())


def _draw_torch(box: bpy.types.UILayout, chosen: bpy.types.AddonPreferences) -> None:
    box.prop(chosen, "pytorch_source")
    if chosen.pytorch_source == "FOLDER":
        box.prop(chosen, "pytorch_folder")
    problem = runtime.problem()
    if problem == runtime.NO_TORCH:
        text = "PyTorch is missing: install the extension's zip that holds it, or name a folder with it"
        draw_notice(box, f"{text}{'' if lock_of(runtime.TORCH) is None else ', or press the button'}", _LINE)
    elif problem:
        draw_notice(box, problem, _LINE)
    elif runtime.needs_restart():
        box.label(text="Restart Blender to use the chosen PyTorch", icon="INFO")
    else:
        box.label(text="PyTorch is there", icon="CHECKMARK")
    _draw_install(box, runtime.TORCH, "Install PyTorch (GPU)")


def _draw_photos(box: bpy.types.UILayout) -> None:
    box.label(text="Photographs without cameras, videos, HEIC")
    absent = libraries.missing(libraries.PHOTOS) if runtime.folder_for(runtime.PHOTOS) is None else []
    if absent:
        box.label(text=f"{', '.join(absent)}: not installed; only this needs them", icon="INFO")
    else:
        box.label(text="The libraries are there", icon="CHECKMARK")
    _draw_install(box, runtime.PHOTOS, "Install Libraries")


def _draw_matting(box: bpy.types.UILayout) -> None:
    box.label(text="Objects of photographs cut out by a larger network")
    if runtime.has_matting():
        box.label(text="The matting model is there", icon="CHECKMARK")
    else:
        box.label(text="No matting model, or nothing to run it; what ships cuts out as well", icon="INFO")
        box.operator("arm.get_matting_model", icon="IMPORT")
    if runtime.installed(runtime.MATTING) is not None:
        _draw_install(box, runtime.MATTING, "Install Libraries")


def _draw_multiview(box: bpy.types.UILayout, chosen: bpy.types.AddonPreferences) -> None:
    box.label(text="Six views from one picture")
    box.prop(chosen, "multiview_folder")
    absent = libraries.missing(libraries.MULTIVIEW) if runtime.folder_for(runtime.MULTIVIEW) is None else []
    if absent:
        box.label(text=f"{', '.join(absent)}: not installed; only this needs them", icon="INFO")
    else:
        box.label(text="The libraries are there; the weights are yours to bring", icon="CHECKMARK")
    _draw_install(box, runtime.MULTIVIEW, "Install Libraries")


def _draw_install(box: bpy.types.UILayout, extra: str, text: str) -> None:
    """The button that installs an extra, or removes it, or why there is none."""
    if runtime.installed(extra) is not None:
        box.operator("arm.remove_libraries", text="Remove What Was Installed", icon="TRASH").extra = extra
    elif lock_of(extra) is None:
        draw_notice(box, NO_LIST, _LINE, icon="INFO")
    else:
        box.operator("arm.install_libraries", text=text, icon="IMPORT").extra = extra
        if not bpy.app.online_access:
            box.label(text=OFFLINE, icon="INFO")


def _draw_weights(box: bpy.types.UILayout) -> None:
    row = box.row(align=True)
    row.operator("arm.list_weights", icon="FILE_REFRESH")
    row.operator("arm.import_weights", icon="FILE_FOLDER")
    for entry, condition, path in weights() or ():
        line = box.column(align=True)
        line.label(text=f"{entry.name}: {condition}; {entry.licence}", icon=_ICONS[condition])
        line.label(text=entry.enables, icon="BLANK1")
        draw_notice(line, str(path) if condition == "whole" else entry.remedy, _LINE, icon="BLANK1")
        if entry.download and condition != "whole":
            line.operator("arm.download_weights", text=f"Download ({entry.download})", icon="IMPORT").name = entry.name


def _draw_work(layout: bpy.types.UILayout) -> None:
    """What is being done, and what the last work failed of."""
    running = background.progress()
    if running is not None:
        row = layout.row(align=True)
        row.progress(factor=running[0], text=running[1])
        row.operator("arm.cancel_setup", text="", icon="X")
    elif background.error():
        draw_notice(layout, background.error(), _LINE)
