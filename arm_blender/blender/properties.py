"""What the user chooses, kept with the scene, and how the running job stands, kept with the window manager."""

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty


class ARM_PG_settings(bpy.types.PropertyGroup):
    """Input and options of the next generation."""

    views_path: StringProperty(
        name="Views",
        description="One image, a folder with transforms.json, or a folder of six images in the rig's order",
        subtype="FILE_PATH",
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
            ("final", "Final", "For close-ups; takes several times as long"),
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


class ARM_PG_state(bpy.types.PropertyGroup):
    """Progress of the running job, for the panel; never saved."""

    fraction: FloatProperty(name="Progress", subtype="FACTOR", min=0.0, max=1.0, options={"SKIP_SAVE"})
    message: StringProperty(name="Message", options={"SKIP_SAVE"})


classes = (ARM_PG_settings, ARM_PG_state)


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
