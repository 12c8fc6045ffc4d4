"""What the user chooses, kept with the scene, and how the running job stands, kept with the window manager."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..compat import BLEND_RELATIVE
from ..input.callbacks import views_changed
from ..input.panel_knobs import properties


class ARM_PG_view(bpy.types.PropertyGroup):
    """One view of the chosen pictures; `name` is that of its file or camera."""

    use: BoolProperty(
        name="Use", description="Take this view into account; without its tick it is left out", default=True
    )
    weight: FloatProperty(
        name="Weight",
        description="How much this view counts in the texture, where others see the same",
        default=1.0,
        min=1e-6,
        max=1e6,
        soft_max=10.0,
    )
    sees: BoolProperty(default=True)
    way: StringProperty(description="How it was cut out")
    doubt: StringProperty(description="Why its mask may be wrong")


class ARM_PG_photograph(bpy.types.PropertyGroup):
    """What became of one photograph whose camera was looked for; `name` is that of its file."""

    view: StringProperty(description="File of the view that was made of it; empty where none was")
    picture: StringProperty(description="File to paint a mask for; empty where there is none")
    registered: BoolProperty(description="Its camera is known")
    doubtful: BoolProperty(description="Its mask may be wrong")
    short: StringProperty(description="What a row has room for")
    whole: StringProperty(description="All that is known of it")


class ARM_PG_settings(bpy.types.PropertyGroup):
    """Input and options of the next generation; the knobs among them are declared in `arm_blender.knobs`."""

    source: EnumProperty(
        name="Pictures",
        description="Where the pictures of the object are",
        items=(
            ("FILES", "Picture Files", "A picture, a folder of views or of photographs, or a video"),
            ("CAMERAS", "Scene Cameras", "The background images of the scene's cameras"),
        ),
        default="FILES",
        update=views_changed,
    )
    views_path: StringProperty(
        name="Views",
        description="A picture, a folder of views or of photographs, or a video of the object",
        subtype="FILE_PATH",
        options=BLEND_RELATIVE,
        update=views_changed,
    )
    views: CollectionProperty(type=ARM_PG_view)
    photographs: CollectionProperty(type=ARM_PG_photograph)
    photograph: IntProperty(name="Photograph", description="The photograph that is told of below the list", default=0)
    views_of: StringProperty(description="What the list of views was read from")
    views_kind: StringProperty(description="picture, rig, posed or photographs")
    multiview_model: StringProperty(
        name="Weights",
        description="Folder of Zero123++'s weights, as diffusers saves a pipeline; they are not shipped",
        subtype="DIR_PATH",
        options=BLEND_RELATIVE,
    )
    shape: EnumProperty(
        name="Shape",
        description="Where the shape of the object comes from",
        items=(
            ("NETWORK", "From Pictures", "Reconstruct the shape from the pictures"),
            ("MESH", "Selected Mesh", "Keep the shape of the active mesh, and its UVs if they are an atlas"),
        ),
        default="NETWORK",
    )
    placement: EnumProperty(
        name="Place",
        description="Where the object goes",
        items=(
            ("cameras", "In Camera Frame", "Where the cameras of the views see it"),
            ("ground", "On Ground", "Standing on the ground at the 3D cursor"),
        ),
        default="ground",
    )
    size: FloatProperty(
        name="Size",
        description="Length of the object's longest side",
        subtype="DISTANCE",
        default=1.0,
        min=1e-3,
        soft_max=100.0,
    )
    as_asset: BoolProperty(
        name="Mark as Asset", description="Show the result in the asset browser, with a preview", default=False
    )


ARM_PG_settings.__annotations__.update(properties())


class ARM_PG_state(bpy.types.PropertyGroup):
    """How the running job stands, how the last one failed or what it made, for the panel; never saved."""

    fraction: FloatProperty(name="Progress", subtype="FACTOR", min=0.0, max=1.0, options={"SKIP_SAVE"})
    message: StringProperty(name="Message", options={"SKIP_SAVE"})
    time: StringProperty(name="Time", options={"SKIP_SAVE"})
    error: StringProperty(name="Error", options={"SKIP_SAVE"})
    views_error: StringProperty(name="Error of the Views", options={"SKIP_SAVE"})
    newest: StringProperty(name="Newest Result", options={"SKIP_SAVE"})
    hidden_by: StringProperty(name="What the Newest Result Lies Inside Of", options={"SKIP_SAVE"})


classes = (ARM_PG_view, ARM_PG_photograph, ARM_PG_settings, ARM_PG_state)


def register() -> None:
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.arm = PointerProperty(type=ARM_PG_settings)
    bpy.types.WindowManager.arm = PointerProperty(type=ARM_PG_state)


def unregister() -> None:
    del bpy.types.WindowManager.arm
    del bpy.types.Scene.arm
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
