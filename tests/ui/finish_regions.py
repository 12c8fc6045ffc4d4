"""Regions in a window: *Materials* opened on a result, a region picked by a click on it, made chrome, undone.

Runs inside Blender.
"""

from collections.abc import Iterator

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Vector
from watch import Watch
from window import area, in_view, module, shoot, window

DOWN = 60
"""Scrolls of the sidebar, to its end: *Materials* stands below the settings."""
SHADERS = 45.0
"""Seconds in which the processor compiles shaders and draws."""


def materials(watch: Watch, generated: Iterator[float]) -> Iterator[float]:
    """`generated` presses *Generate* and waits for the result."""
    yield from generated
    yield 3.0
    shown = window().view_layer.objects.active
    name, material = shown.name, shown.active_material
    nodes, chosen = module("asset.finish_nodes"), module("materials.chosen")
    known = module("asset.regions").known_regions(material).regions
    found = {"regions": len(known), "panel": chosen.active_material(bpy.context) == material}
    found |= yield from pick(shown)
    look_at()
    material.arm_view = "regions"
    yield SHADERS
    shoot("materials-regions")
    material.arm_view = "shaded"
    yield SHADERS
    shoot("materials-predicted")
    with in_view():
        bpy.ops.arm.set_finish("EXEC_DEFAULT", True, finish="chrome")
    yield SHADERS
    shoot("materials-chrome")
    found["set"] = {number: finish.metallic for number, finish in nodes.finishes(material).items()}
    with in_view():
        bpy.ops.ed.undo()
    yield 3.0
    found["left after undo"] = len(nodes.finishes(bpy.data.objects[name].active_material))
    return found


def pick(shown: bpy.types.Object) -> Iterator[float]:
    """*Pick on Object* left by Esc, then by a click on the middle of the object."""
    region = next(region for region in area().regions if region.type == "WINDOW")
    view = area().spaces.active.region_3d
    view.view_location, view.view_distance = shown.matrix_world @ middle(shown), 1.8
    with in_view():
        bpy.ops.view3d.view_axis(type="FRONT")
    yield 2.0
    place = location_3d_to_region_2d(region, view, shown.matrix_world @ middle(shown))
    x, y = region.x + int(place.x), region.y + int(place.y)
    operator, ray = module("materials.pick_operator"), module("materials.ray")
    seen = operator.ray_through(region, view, x, y)
    expected = ray.region_under(shown, bpy.context.evaluated_depsgraph_get(), *seen)
    material = shown.active_material
    material.arm_region = other = 2 if expected == 1 else 1
    yield from begin_picking(x, y)
    yield from press("ESC", x, y)
    left = material.arm_region
    yield from begin_picking(x, y)
    yield from press("LEFTMOUSE", x, y)
    yield 0.5
    return {"left by Esc": left == other, "expected": expected, "picked": shown.active_material.arm_region}


def begin_picking(x: int, y: int) -> Iterator[float]:
    with in_view():
        bpy.ops.arm.pick_region("INVOKE_DEFAULT")
    yield 0.5
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)
    yield 0.3


def press(key: str, x: int, y: int) -> Iterator[float]:
    for value in ("PRESS", "RELEASE"):
        window().event_simulate(type=key, value=value, x=x, y=y)
        yield 0.3


def middle(shown: bpy.types.Object) -> Vector:
    """Of its bounding box."""
    return sum((Vector(corner) for corner in shown.bound_box), Vector()) / 8.0


def look_at() -> None:
    """The sidebar scrolled to its end, and the object under the light of a material preview, without overlays."""
    space = area().spaces.active
    space.shading.type, space.overlay.show_overlays = "MATERIAL", False
    sidebar = next(region for region in area().regions if region.type == "UI")
    with bpy.context.temp_override(window=window(), area=area(), region=sidebar):
        for _ in range(DOWN):
            bpy.ops.view2d.scroll_down()
