"""Six views from one picture, at the press of a button."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy

from ...errors import ArmError
from ...progress import Progress
from ..input import request
from ..input.generation_request import GenerationRequest
from .generation import draw_views
from .operators import Run


class ARM_OT_draw_views(Run, bpy.types.Operator):
    """Have Zero123++ draw six views of the picture, in a folder beside it; look at them, edit them, then generate"""

    bl_idname = "arm.draw_views"
    bl_label = "Draw Six Views"

    def _wanted(self, context: bpy.types.Context) -> GenerationRequest:
        wanted = request.from_panel(context)
        if not isinstance(wanted.views, Path) or not wanted.views.is_file():
            raise ArmError("Choose one picture first; six views are drawn of it")
        if not context.scene.arm.multiview_model:
            raise ArmError("Choose the folder of Zero123++'s weights first: that with model_index.json, unet/ and vae/")
        self._drawing = (
            wanted.views,
            Path(bpy.path.abspath(context.scene.arm.multiview_model)),
            wanted.views.with_name(f"{wanted.views.stem}-views"),
            context.scene.arm.multiview_steps,
        )
        return wanted

    def _networks(self, wanted: GenerationRequest) -> str:
        return "zero123plus"

    def _work(self, wanted: GenerationRequest) -> Callable[[Progress], Path]:
        return partial(draw_views, wanted, *self._drawing)

    def _deliver(self, context: bpy.types.Context, made: Path) -> str:
        context.scene.arm.views_path = str(made)  # Which has them read and shown.
        return f"{made.name}: six views; look at them, then press Generate"


register, unregister = bpy.utils.register_classes_factory((ARM_OT_draw_views,))
