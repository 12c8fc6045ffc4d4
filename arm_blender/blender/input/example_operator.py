"""The example that comes with the extension, as the panel's input."""

from pathlib import Path

import bpy

from ..layout import redraw_sidebars

EXAMPLE = Path(__file__).parents[2] / "examples" / "barrel"
"""Six views with their cameras."""


class ARM_OT_load_example(bpy.types.Operator):
    """Take the six views of a barrel that come with the extension; then press Generate"""

    bl_idname = "arm.load_example"
    bl_label = "Load Example"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not (EXAMPLE / "transforms.json").is_file():
            self.report({"ERROR"}, f"{EXAMPLE}: is not there; install the extension again")
            return {"CANCELLED"}
        settings = context.scene.arm
        settings.source, settings.shape = "FILES", "NETWORK"  # Else Generate would ask for cameras, or for a mesh.
        settings.views_path = str(EXAMPLE)  # Which has them read and shown.
        redraw_sidebars(context)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((ARM_OT_load_example,))
