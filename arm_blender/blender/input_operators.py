"""What the user does before a run: look at the views, put cameras into the scene, take over a result's settings."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import bpy

from ..errors import ArmError
from ..progress import Progress
from . import request, view_list
from .generation import GenerationRequest, draw_views
from .operators import Run, is_running, redraw_sidebars

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


class ARM_OT_draw_views(Run, bpy.types.Operator):
    """Have Zero123++ draw six views of the picture, in a folder beside it; look at them, edit them, then generate"""

    bl_idname = "arm.draw_views"
    bl_label = "Draw Six Views"

    def _wanted(self, context: bpy.types.Context) -> GenerationRequest:
        wanted = request.from_panel(context)
        if not isinstance(wanted.views, Path) or not wanted.views.is_file():
            raise ArmError("Choose one picture first; six views are drawn of it")
        if not context.scene.arm.multiview_model:
            raise ArmError("Choose the folder of Zero123++'s weights first; README.md says where to get them")
        self._drawing = (
            Path(bpy.path.abspath(context.scene.arm.multiview_model)),
            wanted.views.with_name(f"{wanted.views.stem}-views"),
            context.scene.arm.multiview_steps,
        )
        return replace(wanted, preset="zero123plus", weights=None)

    def _work(self, wanted: GenerationRequest) -> Callable[[Progress], Path]:
        return partial(draw_views, wanted, *self._drawing)

    def _deliver(self, context: bpy.types.Context, made: Path) -> str:
        context.scene.arm.views_path = str(made)  # Which has them read and shown.
        return f"{made.name}: six views; look at them, then press Generate"


class ARM_OT_add_cameras(bpy.types.Operator):
    """Put the cameras of the listed views into the scene, with their pictures; without a list, the rig of six views"""

    bl_idname = "arm.add_cameras"
    bl_label = "Add Cameras"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        from .scene_cameras import add_cameras

        settings = context.scene.arm
        seen = view_list.found(context)
        if seen is not None and settings.source == "FILES" and seen.kind != "picture":
            # A picture that was averaged down for the run still has the same view: K fits its shown size.
            views = [(view.name, *view.camera, *view.size, view.path) for view in seen.views]
        else:
            views = _rig(settings.rig_distance, settings.fovy)
        made = add_cameras(context.scene, "ARM cameras", views)
        self.report({"INFO"}, f"{len(made)} cameras added")
        return {"FINISHED"}


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
    settings.preset, settings.quality, settings.seed = kept["preset"], kept["quality"], kept["seed"]
    sizes = {item.identifier for item in settings.bl_rna.properties["texture_size"].enum_items}
    settings.texture_size = str(kept["texture_size"]) if str(kept["texture_size"]) in sizes else "AUTO"
    settings.faces = kept["faces"] or 0
    settings.normal_map = kept["normal_map"]
    settings.own_weights = kept["own_weights"] or ""
    for own, name in (("elevation", "elevation_deg"), ("fovy", "fovy_deg"), ("rig_distance", "rig_distance")):
        if kept[name] is not None:
            setattr(settings, own, kept[name])


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


def _rig(distance: float, fovy_deg: float) -> list[tuple]:
    """The rig of Zero123++ v1.2 without pictures, as `add_cameras` takes it."""
    from ..views.rigs import zero123plus_rig

    rig = enumerate(zero123plus_rig(distance, fovy_deg, RIG_SIDE))
    return [(f"rig {i}", camera.c2w.numpy(), camera.K.numpy(), RIG_SIDE, RIG_SIDE, None) for i, camera in rig]


classes = (ARM_OT_look, ARM_OT_draw_views, ARM_OT_add_cameras, ARM_OT_recall)


def register() -> None:
    for cls in classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Stop a look that is going on first: its thread must not outlive the code that it runs."""
    view_list.forget()
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
