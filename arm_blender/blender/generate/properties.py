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


class ARM_PG_view(bpy.types.PropertyGroup):
    """One view of the chosen pictures; `name` is that of its file or camera."""

    use: BoolProperty(name="Use", description="Take this view into account", default=True)
    weight: FloatProperty(
        name="Weight",
        description="How much this view counts in the texture, where others see the same",
        default=1.0,
        min=1e-6,
        max=1e6,
        soft_max=10.0,
    )
    sees: BoolProperty(default=True)


class ARM_PG_settings(bpy.types.PropertyGroup):
    """Input and options of the next generation."""

    source: EnumProperty(
        name="Pictures",
        description="Where the pictures of the object are",
        items=(
            ("FILES", "Image or Views", "One image, or a folder of views"),
            ("CAMERAS", "Scene Cameras", "The background images of the scene's cameras"),
        ),
        default="FILES",
        update=views_changed,
    )
    views_path: StringProperty(
        name="Views",
        description="One image, a folder with transforms.json, or a folder of six images in the rig's order",
        subtype="FILE_PATH",
        options=BLEND_RELATIVE,
        update=views_changed,
    )
    views: CollectionProperty(type=ARM_PG_view)
    views_of: StringProperty(description="What the list of views was read from")
    views_kind: StringProperty(description="picture, rig or posed")
    multiview_model: StringProperty(
        name="Weights",
        description="Folder of Zero123++'s weights, as diffusers saves a pipeline; they are not shipped",
        subtype="DIR_PATH",
        options=BLEND_RELATIVE,
    )
    multiview_steps: IntProperty(
        name="Steps", description="Of drawing; 75 for faces and fine patterns", default=28, min=1, max=1000
    )
    elevation: FloatProperty(
        name="Elevation",
        description="Degrees by which the picture looks down on the object",
        default=10.0,
        min=-90.0,
        max=90.0,
    )
    fovy: FloatProperty(
        name="Field of View",
        description="Of the assumed cameras, in degrees, from top to bottom",
        default=30.0,
        min=1.0,
        max=170.0,
    )
    rig_distance: FloatProperty(
        name="Distance",
        description="From the rig's cameras to the middle of the object, whose longest side is at most 2",
        default=4.0,
        min=0.1,
        soft_max=10.0,
    )
    shape: EnumProperty(
        name="Shape",
        description="Where the shape of the object comes from",
        items=(
            ("NETWORK", "From Pictures", "Reconstruct it"),
            ("MESH", "Selected Mesh", "Keep the shape of the active mesh, and its UVs if they are an atlas"),
        ),
        default="NETWORK",
    )
    preset: EnumProperty(
        name="Preset",
        description="Size of the networks",
        items=(
            ("small", "Small", "Weights come with the extension; made for the processor"),
            ("paper", "Paper", "The networks of the paper; needs weights of your own and a graphics device"),
            ("instantmesh", "InstantMesh", "Its shape network, whose weights you import; needs a graphics device"),
        ),
        default="small",
    )
    quality: EnumProperty(
        name="Quality",
        description="How fine the shape and the texture may become",
        items=(
            ("draft", "Draft", "For a first look"),
            ("balanced", "Balanced", "For most objects"),
            ("final", "Final", "For close-ups; takes longest"),
        ),
        default="balanced",
    )
    texture_size: EnumProperty(
        name="Texture",
        description="Texels a side at most; the texture is smaller where the views cannot fill it",
        items=(
            ("AUTO", "Automatic", "As the quality says"),
            ("512", "512", "512 x 512"),
            ("1024", "1024", "1024 x 1024"),
            ("2048", "2048", "2048 x 2048"),
        ),
        default="AUTO",
    )
    faces: IntProperty(
        name="Faces",
        description="Triangles that the mesh may have at most; 0 leaves it to the quality",
        default=0,
        min=0,
        soft_max=100_000,
    )
    normal_map: BoolProperty(
        name="Normal Map",
        description="Bake the detail that is lost to the number of faces",
        default=False,
    )
    own_weights: StringProperty(
        name="Own Weights",
        description="Folder of weights that you trained, named as those that ship; for what it lacks those are taken",
        subtype="DIR_PATH",
        options=BLEND_RELATIVE,
    )
    seed: IntProperty(name="Seed", description="The same seed gives the same result", default=0, min=0)
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


class ARM_PG_state(bpy.types.PropertyGroup):
    """How the running job stands and how the last one failed, for the panel; never saved."""

    fraction: FloatProperty(name="Progress", subtype="FACTOR", min=0.0, max=1.0, options={"SKIP_SAVE"})
    message: StringProperty(name="Message", options={"SKIP_SAVE"})
    time: StringProperty(name="Time", options={"SKIP_SAVE"})
    error: StringProperty(name="Error", options={"SKIP_SAVE"})
    views_error: StringProperty(name="Error of the Views", options={"SKIP_SAVE"})


classes = (ARM_PG_view, ARM_PG_settings, ARM_PG_state)


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
