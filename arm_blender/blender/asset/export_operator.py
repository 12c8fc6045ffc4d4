"""File > Export: an object of ours as GLB, USD, USDZ and OBJ, with its maps."""

from pathlib import Path

import bpy
from bpy.props import EnumProperty, StringProperty

from ...errors import ArmError

_FORMATS = (
    ("glb", "GLB", "glTF 2.0, the maps inside"),
    ("usd", "USD", "The maps beside it"),
    ("usdz", "USDZ", "The maps inside"),
    ("obj", "OBJ", "OBJ and MTL, the maps beside them"),
)


class ARM_OT_export(bpy.types.Operator):
    """Write the active object with its material maps and what is set of them, in one format or several"""

    bl_idname = "arm.export"
    bl_label = "Export Relightable Asset"

    directory: StringProperty(name="Folder", description="Where the files go", subtype="DIR_PATH")
    formats: EnumProperty(
        name="Formats", description="What to write", items=_FORMATS, options={"ENUM_FLAG"}, default={"glb"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        active = context.active_object
        if active is None or active.type != "MESH":
            cls.poll_message_set("Select a mesh")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not self.formats or not self.directory:
            self.report({"ERROR"}, "Choose a folder and at least one format")
            return {"CANCELLED"}
        from ...export import write_files  # It brings torch, which takes seconds.
        from .object_asset import asset_from_object

        try:
            asset = asset_from_object(context.active_object)
            wanted = [name for name, _, _ in _FORMATS if name in self.formats]
            files = write_files(asset, Path(bpy.path.abspath(self.directory)) / asset.name, wanted)
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(files)} files in {files[0].parent}")
        return {"FINISHED"}


def _draw_entry(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator(ARM_OT_export.bl_idname, text="Relightable Asset (.glb, .usda, .usdz, .obj)")


def register() -> None:
    bpy.utils.register_class(ARM_OT_export)
    bpy.types.TOPBAR_MT_file_export.append(_draw_entry)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_export.remove(_draw_entry)
    bpy.utils.unregister_class(ARM_OT_export)
