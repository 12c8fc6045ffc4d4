"""What the user does before a run: look at the views, put their cameras into the scene."""

from typing import TYPE_CHECKING

import bpy

from ...errors import ArmError
from . import view_list

if TYPE_CHECKING:  # It brings numpy.
    from .scene_cameras import PlacedPicture

RIG_SIDE = 320
"""Pixels a side of the rig's pictures, as Zero123++ draws them; without pictures nothing depends on it."""


class ARM_OT_look(bpy.types.Operator):
    """Read the pictures again and list them; ticks and weights stay where they are the same views"""

    bl_idname = "arm.look"
    bl_label = "Refresh Views"

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.arm.views_error = ""
        try:
            view_list.look_now(context)
        except ArmError as error:
            context.window_manager.arm.views_error = str(error)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """From the panel: the pictures are read on a thread."""
        if bpy.app.background:
            return self.execute(context)
        view_list.look_soon(context)
        return {"FINISHED"}


class ARM_OT_add_cameras(bpy.types.Operator):
    """Put the cameras of the listed views into the scene, with their pictures; without a list, the rig of six views"""

    bl_idname = "arm.add_cameras"
    bl_label = "Add Cameras"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        from .scene_cameras import add_cameras

        settings = context.scene.arm
        seen = view_list.found(context)
        if seen is not None and settings.source == "FILES" and seen.kind in ("rig", "posed"):
            # A picture that was averaged down for the run still has the same view: K fits its shown size.
            posed = [(view, view.camera) for view in seen.views if view.camera is not None]
            views: list[PlacedPicture] = [(view.name, *camera, *view.size, view.path) for view, camera in posed]
        else:
            views = _rig(settings.rig_distance, settings.fovy)
        made = add_cameras(context.scene, "ARM cameras", views)
        self.report({"INFO"}, f"{len(made)} cameras added")
        return {"FINISHED"}


def _rig(distance: float, fovy_deg: float) -> "list[PlacedPicture]":
    """The rig of Zero123++ v1.2 without pictures, as `add_cameras` takes it."""
    from ...views.rigs import zero123plus_rig

    rig = enumerate(zero123plus_rig(distance, fovy_deg, RIG_SIDE))
    return [(f"rig {i}", camera.c2w.numpy(), camera.K.numpy(), RIG_SIDE, RIG_SIDE, None) for i, camera in rig]


classes = (ARM_OT_look, ARM_OT_add_cameras)

_register_classes, _unregister_classes = bpy.utils.register_classes_factory(classes)


def register() -> None:
    _register_classes()
    for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
        handlers.append(view_list.look_after_undo)


def unregister() -> None:
    """Stop a look that is going on first: its thread must not outlive the code that it runs."""
    for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
        handlers.remove(view_list.look_after_undo)
    view_list.forget()
    _unregister_classes()
