"""What the user chooses for relighting, kept with the scene."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ..compat import BLEND_RELATIVE
from .callbacks import environment_turned, environments

FILE = StringProperty(
    name="File",
    description="Panorama that lights the object, an equirectangular .hdr or .exr",
    subtype="FILE_PATH",
    options=BLEND_RELATIVE,
)


class ARM_PG_relight(bpy.types.PropertyGroup):
    """Environment, what turns, and how it is rendered."""

    environment: EnumProperty(name="Environment", description="What lights the object", items=environments)
    environment_file: FILE
    compare: BoolProperty(name="Compare", description="Show a second environment beside the first", default=False)
    second: EnumProperty(name="Second", description="What lights the object on the right", items=environments)
    second_file: FILE
    rotation: FloatProperty(
        name="Rotation",
        description="Angle that the environment is turned by, about the vertical axis",
        subtype="ANGLE",
        default=0.0,
        update=environment_turned,
    )
    turning: EnumProperty(
        name="Turn",
        description="What goes round in a sequence",
        items=(
            ("object", "Object", "A turntable under a light that stands still"),
            ("environment", "Environment", "The light goes round an object that stands still"),
        ),
        default="object",
    )
    turntable: IntProperty(
        name="Pictures", description="Number of pictures in one full turn", default=24, min=2, max=3600
    )
    video: BoolProperty(name="Video", description="Also write the sequence as an .mp4", default=False)
    frames_per_second: IntProperty(
        name="Frame Rate", description="Pictures a second of the video", default=24, min=1, max=240
    )
    engine: EnumProperty(
        name="Engine",
        description="What renders the pictures",
        items=(
            ("cycles", "Cycles", "Light as it is, mirrors and shadows included; slower"),
            ("eevee", "Eevee", "An approximation, fast on a graphics device"),
        ),
        default="cycles",
    )
    resolution: IntProperty(
        name="Resolution", description="Width and height of a picture, in pixels", default=512, min=16, max=8192
    )
    samples: IntProperty(
        name="Samples",
        description="Paths of light for each pixel: more of them take longer and leave less noise",
        default=32,
        min=1,
        max=65536,
    )
    view: IntProperty(
        name="View",
        description="Number of the picture, of those that the active object was made from",
        default=1,
        min=1,
    )
    output: StringProperty(
        name="Output",
        description="Folder that the pictures are written to; // is that of the saved file",
        subtype="DIR_PATH",
        default="//relight/",
        options=BLEND_RELATIVE,
    )


def register() -> None:
    bpy.utils.register_class(ARM_PG_relight)
    bpy.types.Scene.arm_relight = PointerProperty(type=ARM_PG_relight)


def unregister() -> None:
    del bpy.types.Scene.arm_relight
    bpy.utils.unregister_class(ARM_PG_relight)
