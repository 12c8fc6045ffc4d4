"""The panel's settings taken from a result: what it was made with can be looked at, changed and made again."""

import bpy

from ...asset_record import AssetRecord
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
            _recall(context, request.stored_record(context.object))
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        redraw_sidebars(context)
        return {"FINISHED"}


def _recall(context: bpy.types.Context, kept: AssetRecord) -> None:
    """The panel's settings from those of a result; its views, where they are known, with their ticks and weights."""
    settings = context.scene.arm
    if kept.views is not None or kept.cameras is not None:
        _fill_list(context, kept)  # First: choosing the views has them read, which keeps the ticks of a list that fits.
        settings.source = "CAMERAS" if kept.views is None else "FILES"
        if kept.views is not None:
            settings.views_path = str(kept.views)
        set_panel(settings, ViewKnobs, kept.chosen)
    settings.shape = "NETWORK" if kept.mesh is None else "MESH"
    set_panel(settings, Knobs, kept.chosen)


def _fill_list(context: bpy.types.Context, kept: AssetRecord) -> None:
    settings, weights = context.scene.arm, kept.chosen["weights"]
    settings.views.clear()
    settings.views_of = ""
    if weights is None:
        return
    names = kept.cameras or [f"view {index}" for index in range(len(weights))]
    for name, weight in zip(names, weights, strict=False):
        item = settings.views.add()
        item.name, item.use, item.weight = name, weight > 0.0, weight or 1.0
    settings.views_of = request.cameras_key(context) if kept.views is None else request.path_key(str(kept.views))


register, unregister = bpy.utils.register_classes_factory((ARM_OT_recall,))
