"""The panel's settings taken from a result: what it was made with can be looked at, changed and made again."""

import bpy

from ...errors import ArmError
from ...knobs import Knobs, ViewKnobs
from ..input import request
from ..input.panel_knobs import set_panel
from ..layout import redraw_sidebars
from .operators import is_running


class ARM_OT_recall(bpy.types.Operator):
    """Set the panel to what the active result was made with"""

    bl_idname = "arm.recall"
    bl_label = "Recall Settings"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if is_running():
            cls.poll_message_set("A generation is running")
            return False
        return context.object is not None and "arm_settings" in context.object

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            kept = request.stored_settings(context.object)
            _recall(context, kept)
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        redraw_sidebars(context)
        return {"FINISHED"}


def _recall(context: bpy.types.Context, kept: dict) -> None:
    """The panel's settings from those of a result; its views are listed with their ticks and weights."""
    settings = context.scene.arm
    _fill_list(context, kept)  # First: choosing the views has them read, which keeps the ticks of a list that fits.
    if kept["views"]:
        settings.source, settings.views_path = "FILES", kept["views"]
    else:
        settings.source = "CAMERAS"
    settings.shape = "MESH" if kept.get("mesh") else "NETWORK"
    for declared in (Knobs, ViewKnobs):
        set_panel(settings, declared, kept)


def _fill_list(context: bpy.types.Context, kept: dict) -> None:
    settings = context.scene.arm
    settings.views.clear()
    settings.views_of = ""
    if kept["weights"] is None:
        return
    names = kept["cameras"] or [f"view {index}" for index in range(len(kept["weights"]))]
    for name, weight in zip(names, kept["weights"], strict=False):
        item = settings.views.add()
        item.name, item.use, item.weight = name, weight > 0.0, weight or 1.0
    settings.views_of = request.path_key(kept["views"]) if kept["views"] else request.cameras_key(context)


classes = (ARM_OT_recall,)


def register() -> None:
    for cls in classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
