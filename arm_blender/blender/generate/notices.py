"""What went wrong, in lines that fit the sidebar, with the button that mends it."""

from pathlib import Path

import bpy

from ..layout import draw_notice, line_width
from ..setup import runtime
from .matting_operator import wants_matting
from .photograph_rows import draw_edit_mask

NO_FOREGROUND = ": no foreground found"
"""Follows the picture in an error that a painted mask mends."""


def draw_error(layout: bpy.types.UILayout, context: bpy.types.Context, message: str) -> None:
    """One message, as many lines as the sidebar needs for it."""
    if not message:
        return
    box = layout.box()
    box.alert = True
    draw_notice(box, message, line_width(context))
    box.alert = False
    if wants_matting(message) and not runtime.has_matting():
        box.operator("arm.get_matting_model", icon="IMPORT")
    picture = Path(message.partition(NO_FOREGROUND)[0])
    if NO_FOREGROUND in message and picture.is_absolute():  # Else it is the name of a camera.
        chosen = Path(bpy.path.abspath(context.scene.arm.views_path))
        root = chosen if chosen in picture.parents else picture.parent
        draw_edit_mask(box, picture, root, message, "Paint Its Mask")
