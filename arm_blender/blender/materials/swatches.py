"""Icons of one colour each."""

from array import array

import bpy.utils.previews
from mathutils import Color

_SIDE = 16

_previews: bpy.utils.previews.ImagePreviewCollection | None = None


def swatch(color: tuple[float, float, float]) -> int:
    """The icon of a colour, linear Rec.709 in [0, 1]."""
    global _previews
    if _previews is None:
        _previews = bpy.utils.previews.new()
    name = "{:.3f} {:.3f} {:.3f}".format(*color)
    if name not in _previews:
        pixels = array("f", (*Color(color).from_scene_linear_to_srgb(), 1.0) * _SIDE**2)  # numpy would load too early.
        made = _previews.new(name)
        made.image_size = made.icon_size = (_SIDE, _SIDE)
        made.image_pixels_float.foreach_set(pixels)
        made.icon_pixels_float.foreach_set(pixels)
    return _previews[name].icon_id


def register() -> None:
    """Nothing is drawn yet."""


def unregister() -> None:
    global _previews
    if _previews is not None:
        bpy.utils.previews.remove(_previews)
        _previews = None
