"""Choose a region by a click on the object."""

import bpy
from mathutils import Vector

from ..layout import redraw_sidebars
from .chosen import may_be_set
from .ray import region_under

_NAVIGATION = {"MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "NDOF_MOTION"}


class ARM_OT_pick_region(bpy.types.Operator):
    """Choose the region under the next click on the object; Esc leaves"""

    bl_idname = "arm.pick_region"
    bl_label = "Pick on Object"
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not may_be_set(cls, context):
            return False
        if context.mode != "OBJECT":
            cls.poll_message_set("Go back to Object Mode")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self._name = context.object.name
        context.window.cursor_modal_set("EYEDROPPER")
        context.workspace.status_text_set(f"Click on {self._name} to choose a region  |  Esc: leave")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in _NAVIGATION:
            return {"PASS_THROUGH"}
        if event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            self.cancel(context)
            return {"CANCELLED"}
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"RUNNING_MODAL"}
        found = viewport_under(context.window, event.mouse_x, event.mouse_y)
        shown = bpy.data.objects.get(self._name)
        if found is None or shown is None:  # A click elsewhere is meant for what is there.
            self.cancel(context)
            return {"CANCELLED", "PASS_THROUGH"}
        ray = ray_through(*found, event.mouse_x, event.mouse_y)
        number = region_under(shown, context.evaluated_depsgraph_get(), *ray)
        if not number:
            why = f"missed {self._name}" if number is None else "there is no region"
            context.workspace.status_text_set(f"The click {why}; click again  |  Esc: leave")
            return {"RUNNING_MODAL"}
        shown.active_material.arm_region = number
        self.cancel(context)
        redraw_sidebars(context)
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Also called by Blender before it loads another file and when it quits."""
        if context.window is not None:
            context.window.cursor_modal_restore()
        if context.workspace is not None:
            context.workspace.status_text_set(None)


def ray_through(region: bpy.types.Region, view: bpy.types.RegionView3D, x: int, y: int) -> tuple[Vector, Vector]:
    """Origin and direction, in the world, of what a 3D view shows at a pixel of its window."""
    from bpy_extras import view3d_utils  # Blender's own, but not loaded with it.

    place = Vector((x - region.x, y - region.y))
    origin = view3d_utils.region_2d_to_origin_3d(region, view, place)
    return origin, view3d_utils.region_2d_to_vector_3d(region, view, place)


def viewport_under(window: bpy.types.Window, x: int, y: int) -> tuple[bpy.types.Region, bpy.types.RegionView3D] | None:
    """The 3D view at a pixel of a window, where no sidebar, toolbar or header covers it."""
    for area in window.screen.areas:
        if area.type != "VIEW_3D":
            continue
        at = [region for region in area.regions if _holds(region, x, y)]
        if at and all(region.type == "WINDOW" for region in at):
            return at[0], _view_of(area, at[0])
    return None


def _holds(region: bpy.types.Region, x: int, y: int) -> bool:
    return region.x <= x < region.x + region.width and region.y <= y < region.y + region.height


def _view_of(area: bpy.types.Area, region: bpy.types.Region) -> bpy.types.RegionView3D:
    """What a region of a 3D view looks at; in a quad view each looks elsewhere."""
    space = area.spaces.active
    windows = [one for one in area.regions if one.type == "WINDOW"]
    return space.region_quadviews[windows.index(region)] if len(windows) > 1 else space.region_3d


register, unregister = bpy.utils.register_classes_factory((ARM_OT_pick_region,))
