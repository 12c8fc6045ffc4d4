"""Masks of pictures, open in Image Editors to be painted on, and saved to where the next run finds them."""

from pathlib import Path

import bpy

from ...errors import OutputError
from ..compat import reason

_MARK = "arm_mask_of"
"""The property of an image that is the mask of a picture: the picture's file."""

_EDITOR = "IMAGE_EDITOR"

_SETTLED = 0.3
"""Seconds until a new window has been drawn."""


def open_mask(mask: Path, picture: Path) -> bpy.types.Image:
    """The image of a mask's file, as the file has it now unless somebody is painting on it."""
    image = bpy.data.images.load(str(mask), check_existing=True)
    image.name = f"Mask of {picture.name}"
    if image.colorspace_settings.name != "Non-Color":
        image.colorspace_settings.name = "Non-Color"  # White paint becomes 1, whatever the scene's colours.
    if not image.is_dirty:
        image.reload()
    image[_MARK] = str(picture)
    return image


def unsaved() -> list[bpy.types.Image]:
    """The masks that were painted on and not saved."""
    return [image for image in bpy.data.images if is_mask(image) and image.is_dirty]


def is_mask(image: bpy.types.Image | None) -> bool:
    """Whether an image was opened by `open_mask`."""
    return image is not None and _MARK in image


def save_painted() -> int:
    """Save all masks that were painted on; how many.

    Raises:
        OutputError: one cannot be written.
    """
    painted = unsaved()
    for image in painted:
        try:
            image.save()
        except RuntimeError as error:
            place = bpy.path.abspath(image.filepath)
            raise OutputError(f"{place}: cannot be written ({reason(error)}); check its rights") from error
    return len(painted)


def show(context: bpy.types.Context, mask: bpy.types.Image) -> None:
    """Show a mask to be painted on beside its picture: where the last one was, or in a new window."""
    manager = context.window_manager
    shown = [
        (window, area)
        for window in manager.windows
        for area in window.screen.areas
        if area.type == _EDITOR and is_mask(area.spaces.active.image)
    ]
    if shown:
        window = shown[0][0]
    else:
        bpy.ops.wm.window_new()
        window = manager.windows[-1]
        area = window.screen.areas[0]
        area.type = area.ui_type = _EDITOR
        with context.temp_override(window=window, area=area, region=area.regions[-1]):
            bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    editors = sorted((area for area in window.screen.areas if area.type == _EDITOR), key=lambda area: area.x)
    picture = _picture(mask)
    for area, image, mode in ((editors[-1], picture, "VIEW"), (editors[0], mask, "PAINT")):
        if image is not None:
            area.spaces.active.image = image
            area.spaces.active.mode = mode
    _paint_white(context)
    bpy.app.timers.register(_fit, first_interval=_SETTLED)


def _fit() -> None:
    """Show masks and pictures whole, once their editors have a size."""
    for window in bpy.context.window_manager.windows:
        editors = [area for area in window.screen.areas if area.type == _EDITOR]
        if any(is_mask(area.spaces.active.image) for area in editors):
            for area in editors:
                region = next(region for region in area.regions if region.type == "WINDOW")
                with bpy.context.temp_override(window=window, area=area, region=region):
                    bpy.ops.image.view_all(fit_view=True)


def _picture(mask: bpy.types.Image) -> bpy.types.Image | None:
    """That of a mask; None where Blender does not read such files."""
    try:
        image = bpy.data.images.load(mask[_MARK], check_existing=True)
    except RuntimeError:
        return None
    return image if image.size[0] else None


def _paint_white(context: bpy.types.Context) -> None:
    """White is the first colour, black the second, which Ctrl paints."""
    tools = context.scene.tool_settings
    unified = getattr(tools.image_paint, "unified_paint_settings", None)  # Since 5.0 each mode has its own.
    unified = tools.unified_paint_settings if unified is None else unified
    unified.use_unified_color = True
    unified.color, unified.secondary_color = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
