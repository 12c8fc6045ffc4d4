"""Whether a new result can be seen at all: the cube of Blender's start file is larger than an object of one metre."""

import bpy
from mathutils import Vector

_DRAWN = {"SOLID", "TEXTURED"}


def hider_of(context: bpy.types.Context, made: bpy.types.Object) -> bpy.types.Object | None:
    """A visible mesh that `made` lies inside of, or None."""
    context.view_layer.update()  # Where it stands is known only then.
    others = (other for other in context.view_layer.objects if other is not made)
    return next((other for other in others if hides(other, made)), None)


def hides(other: bpy.types.Object, made: bpy.types.Object) -> bool:
    """Whether `other` is a mesh that is seen, and whose box has that of `made` inside."""
    if other.type != "MESH" or other.display_type not in _DRAWN or not other.visible_get():
        return False
    outer, inner = _box(other), _box(made)
    return all(outer[0][axis] <= inner[0][axis] and inner[1][axis] <= outer[1][axis] for axis in range(3))


def _box(item: bpy.types.Object) -> tuple[list[float], list[float]]:
    """The lowest and the highest corner of an object's box in the world."""
    axes = list(zip(*(item.matrix_world @ Vector(corner) for corner in item.bound_box), strict=True))
    return [min(axis) for axis in axes], [max(axis) for axis in axes]
