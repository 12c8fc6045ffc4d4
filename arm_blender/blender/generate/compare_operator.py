"""The active result beside one of its views. A thin wrapper around `relight.view_comparison`."""

from pathlib import Path

import bpy

from ...errors import ArmError
from ...progress import silent
from ..asset.predicted_light import has_light, light_file
from ..input import request
from ..setup import runtime
from .operators import is_running


class ARM_OT_compare_view(bpy.types.Operator):
    """Render the active result as the chosen view shows it, under the light that was predicted from its views, \
beside that view; where the difference glows, material or shape is wrong"""

    bl_idname = "arm.compare_view"
    bl_label = "Compare with View"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if is_running():
            cls.poll_message_set("A generation is running")
            return False
        if not has_light(context.object):
            cls.poll_message_set("Select a result that keeps the light of its views")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..relight.operators import show_picture

        try:
            runtime.prepare()
            picture, line = _compare(context)
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        show_picture(context, picture)
        self.report({"INFO"}, f"{line}: {picture}")
        return {"FINISHED"}


def _compare(context: bpy.types.Context) -> tuple[Path, str]:
    """The sheet, and what it says.

    Raises:
        ArmError: the views are gone, there is no such one, or it cannot be rendered.
    """
    import torch

    from ...report import Report
    from ...views.scene_frame import SceneFrame
    from ..input.generation_request import read_views
    from ..relight.operators import output_folder
    from ..relight.renders import RelightConfig
    from ..relight.view_comparison import AskedView, compare_with_view

    settings, shown = context.scene.arm_relight, context.object
    folder, light = output_folder(settings.output), light_file(shown)
    wanted, kept = request.from_result(context), request.stored_record(shown)
    if wanted.length is not None or kept.frame is None:  # Cameras and object have lost each other.
        raise ArmError(f"{shown.name}: was made to a length; generate it without one to compare it with its views")
    views = read_views(wanted, silent, Report(wanted.preset, "cpu", wanted.seed)).chosen()
    index = settings.view - 1
    if index >= len(views.cameras):
        raise ArmError(f"{shown.name}: has no view {settings.view}; it was made from {len(views.cameras)}")
    scale, *center = kept.frame
    gains = (kept.report or {}).get("gains")
    asked = AskedView(
        views.images[index],
        SceneFrame(torch.tensor(center), scale).normalised(views.cameras[index]),
        None if gains is None else torch.tensor(gains[index]),
    )
    sheet = folder / f"{bpy.path.clean_name(shown.name)}_view_{settings.view:03d}.png"
    config = RelightConfig(settings.engine, settings.resolution, settings.samples)
    found = compare_with_view(shown, asked, light, sheet, config)
    return sheet, "They nowhere meet" if found is None else f"{views.called[index]}, {found:.1f} dB"


register, unregister = bpy.utils.register_classes_factory((ARM_OT_compare_view,))
