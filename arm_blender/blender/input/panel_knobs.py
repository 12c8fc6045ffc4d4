"""The knobs that Blender's panel shows, as properties of the scene's settings, and their values there and back."""

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ...knobs import DrawingKnobs, Knobs, ViewKnobs, knobs_of
from ...knobs.declaring import Knob, Shown
from ..compat import BLEND_RELATIVE


def properties() -> dict[str, Any]:
    """The annotations that make Blender's properties, by their names."""
    declared = (one for kind in (ViewKnobs, DrawingKnobs, Knobs) for one in knobs_of(kind))
    return {one.shown.name or one.name: _property(one, one.shown) for one in declared if one.shown is not None}


def panel_values(settings: bpy.types.PropertyGroup, declared: type) -> dict[str, Any]:
    """What the panel says of a class's knobs; those that it does not show are left to their defaults."""
    found = {}
    for one in knobs_of(declared):
        if one.shown is not None:
            value = getattr(settings, one.shown.name or one.name)
            value = bpy.path.abspath(value) if one.kind is Path else value
            found[one.name] = None if value == one.shown.none else one.kind(value)
    return found


def set_panel(settings: bpy.types.PropertyGroup, declared: type, values: dict[str, Any]) -> None:
    """Sets the panel to values of a class's knobs; what it cannot show becomes what stands for None, or its default."""
    for one in knobs_of(declared):
        if one.shown is not None and one.name in values:
            value = values[one.name]
            if value is not None and one.shown.items:
                value = str(value) if str(value) in [key for key, _, _ in one.shown.items] else None
            value = next((it for it in (value, one.shown.none, one.shown.default) if it is not None), None)
            if value is not None:
                setattr(settings, one.shown.name or one.name, str(value) if one.kind is Path else value)


def _property(one: Knob, shown: Shown) -> Any:
    """The property of a knob, which Blender makes of the annotation."""
    default = one.default if shown.default is None else shown.default
    words = {"name": shown.title, "description": shown.tip, "default": shown.none if default is None else default}
    if one.kind is bool:
        return BoolProperty(**words)
    if shown.items:
        return EnumProperty(items=shown.items, **words)
    if one.kind is Path:
        return StringProperty(subtype="DIR_PATH", options=BLEND_RELATIVE, **words)
    if one.kind is str:
        return StringProperty(**words)
    ends = {"min": shown.low, "max": shown.high, "soft_max": shown.soft_high}
    make = IntProperty if one.kind is int else FloatProperty
    return make(**words, **{end: value for end, value in ends.items() if value is not None})
