"""Photographs, a folder of them or a video, chosen in Blender's file browser."""

from pathlib import Path

import bpy
from bpy.props import BoolProperty, CollectionProperty, StringProperty

from ...errors import ArmError
from . import view_list
from .chosen_pictures import chosen_path


class ARM_OT_choose_photographs(bpy.types.Operator):
    """Choose photographs of one object: several files, a folder (choose no file in it), or a video"""

    bl_idname = "arm.choose_photographs"
    bl_label = "Choose Photographs"
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    files: CollectionProperty(type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_image: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_movie: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_glob: StringProperty(default="*.heic;*.heif", options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = Path(bpy.path.abspath(self.directory))
        names = [file.name for file in self.files if file.name]
        try:
            if not self.directory or not folder.is_dir():
                raise ArmError("Choose files, or the folder that they are in")
            place = chosen_path(folder, names)
        except (ArmError, OSError) as error:  # Of the disk, as it says it.
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        settings = context.scene.arm
        settings.source = "FILES"
        settings.views_path = str(place)  # Which has them read and shown.
        if len(names) > 1 and place != folder:
            self.report({"INFO"}, f"{len(names)} pictures, in {place}")
        view_list.look_soon(context)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((ARM_OT_choose_photographs,))
