"""The mask of a picture, painted by the user: opened at the press of a button, and used."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy
from bpy.props import StringProperty

from ...errors import ArmError
from ...progress import Progress
from ..input import mask_painting, request, view_list
from ..input.generation_request import GenerationRequest
from .operators import Run


def begin_mask(picture: Path, root: Path, progress: Progress) -> Path:
    """The file to paint a picture's mask on. On a worker thread: no bpy here.

    Raises:
        ArmError: as `mask_to_paint`.
    """
    progress(0.0, f"the mask of {picture.name}")
    from ...views.mask_files import mask_to_paint

    return mask_to_paint(picture, root)


class ARM_OT_edit_mask(Run, bpy.types.Operator):
    """Paint the mask of this picture: white is the object, black (hold Ctrl) is not. It is kept in masks/ beside the
    picture, and goes before every other way to find the object"""

    bl_idname = "arm.edit_mask"
    bl_label = "Edit Mask"

    picture: StringProperty(
        name="Picture", description="File to paint the mask of", subtype="FILE_PATH", options={"SKIP_SAVE"}
    )
    root: StringProperty(name="Folder", description="Of the views", subtype="DIR_PATH", options={"SKIP_SAVE"})
    told: StringProperty(description="What is known of the mask, for the tooltip", options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return f"{properties.told}\n\n{cls.__doc__}" if properties.told else str(cls.__doc__)

    def _wanted(self, context: bpy.types.Context) -> GenerationRequest:
        wanted = request.views_from_panel(context)
        if not self.picture:
            raise ArmError("Choose the picture whose mask is to be painted first")
        self._picture = Path(bpy.path.abspath(self.picture))
        self._root = Path(bpy.path.abspath(self.root)) if self.root else self._picture.parent
        return wanted

    def _networks(self, wanted: GenerationRequest) -> str:
        return "mask"

    def _work(self, wanted: GenerationRequest) -> Callable[[Progress], Path]:
        return partial(begin_mask, self._picture, self._root)

    def _deliver(self, context: bpy.types.Context, made: Path) -> str:
        mask = mask_painting.open_mask(made, self._picture)
        if not bpy.app.background and context.window_manager.windows:
            mask_painting.show(context, mask)
        return f"{made.name}: paint white where the object is and black where it is not, then press Use Masks"


class ARM_OT_use_masks(bpy.types.Operator):
    """Save the masks that were painted; the next run takes them"""

    bl_idname = "arm.use_masks"
    bl_label = "Use Masks"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not mask_painting.unsaved():
            cls.poll_message_set("No mask was painted since it was saved")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            count = mask_painting.save_painted()
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        view_list.look_soon(context)
        self.report({"INFO"}, f"{count} mask{'s' if count > 1 else ''} saved")
        return {"FINISHED"}


def _draw_header(header: bpy.types.Header, context: bpy.types.Context) -> None:
    """The button beside a mask that is being painted; in front, where no narrow header cuts it off."""
    if mask_painting.is_mask(context.space_data.image):
        header.layout.operator("arm.use_masks", icon="CHECKMARK")


classes = (ARM_OT_edit_mask, ARM_OT_use_masks)

_register_classes, _unregister_classes = bpy.utils.register_classes_factory(classes)


def register() -> None:
    _register_classes()
    bpy.types.IMAGE_HT_header.prepend(_draw_header)


def unregister() -> None:
    bpy.types.IMAGE_HT_header.remove(_draw_header)
    _unregister_classes()
