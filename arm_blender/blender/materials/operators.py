"""Choose a region, give it a finish, take it away again. Each is one step to undo."""

import bpy
from bpy.props import EnumProperty, IntProperty

from ...knobs.finishes import MOST_REGIONS, PRESETS
from ..asset.finish_nodes import finishes
from .chosen import chosen_region, give, may_be_set, reset_all
from .presets import items


class _OnRegions:
    """An operator on the regions of the active object's material."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return may_be_set(cls, context)


class ARM_OT_choose_region(_OnRegions, bpy.types.Operator):
    """Show the finish of this region, and set it"""

    bl_idname = "arm.choose_region"
    bl_label = "Choose Region"

    number: IntProperty(name="Region", description="Its number; 1 is the largest", default=1, min=1, max=MOST_REGIONS)

    def execute(self, context: bpy.types.Context) -> set[str]:
        material = context.object.active_material
        material.arm_region = self.number
        return {"FINISHED"}


class ARM_OT_set_finish(_OnRegions, bpy.types.Operator):
    """Make the chosen region of this: its roughness, whether it is metal, and the color of a metal"""

    bl_idname = "arm.set_finish"
    bl_label = "Set Finish"

    finish: EnumProperty(name="Finish", description="What the region is made of", items=items())

    def execute(self, context: bpy.types.Context) -> set[str]:
        material = context.object.active_material
        give(material, _number(material), PRESETS[self.finish])
        return {"FINISHED"}


class ARM_OT_reset_finish(_OnRegions, bpy.types.Operator):
    """Take the region's finish away: it is as predicted again"""

    bl_idname = "arm.reset_finish"
    bl_label = "Reset to Predicted"

    number: IntProperty(
        name="Region",
        description="Its number; 0 is the chosen one",
        default=0,
        min=0,
        max=MOST_REGIONS,
        options={"SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        material = context.object.active_material
        number = self.number or _number(material)
        if number not in finishes(material):
            self.report({"INFO"}, f"Region {number} is as predicted")
            return {"CANCELLED"}
        give(material, number, None)
        return {"FINISHED"}


class ARM_OT_reset_finishes(_OnRegions, bpy.types.Operator):
    """Take all finishes away: every region is as predicted again"""

    bl_idname = "arm.reset_finishes"
    bl_label = "Reset All to Predicted"

    def execute(self, context: bpy.types.Context) -> set[str]:
        reset_all(context.object.active_material)
        return {"FINISHED"}


def _number(material: bpy.types.Material) -> int:
    """Of the chosen region; `poll` has seen that there is one."""
    region = chosen_region(material)
    return 0 if region is None else region.number


classes = (ARM_OT_choose_region, ARM_OT_set_finish, ARM_OT_reset_finish, ARM_OT_reset_finishes)

register, unregister = bpy.utils.register_classes_factory(classes)
