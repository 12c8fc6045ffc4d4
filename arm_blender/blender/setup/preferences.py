"""The extension's preferences: settings of this machine rather than of a scene."""

import bpy
from bpy.props import EnumProperty, IntProperty, StringProperty

from .panel import draw_setup
from .stored import BASE_PACKAGE


class ARM_preferences(bpy.types.AddonPreferences):
    """Settings of this machine rather than of a scene."""

    bl_idname = BASE_PACKAGE

    device: EnumProperty(
        name="Device",
        description="Where the networks run",
        items=(
            ("auto", "Automatic", "A CUDA graphics device where PyTorch finds one, else the processor"),
            ("cpu", "Processor", "Everywhere"),
            ("cuda", "CUDA", "NVIDIA's graphics devices; needs a PyTorch made for them"),
            ("mps", "Metal", "Apple's graphics devices"),
        ),
        default="auto",
    )
    threads: IntProperty(
        name="Threads",
        description="Processor threads for the networks; 0 takes all but one, so that Blender stays usable",
        default=0,
        min=0,
        soft_max=64,
    )
    pytorch_source: EnumProperty(
        name="PyTorch",
        description="Where PyTorch comes from",
        items=(
            ("BUNDLED", "From the Extension", "The one that came with the extension, or that Blender's Python has"),
            ("INSTALLED", "Installed Here", "The one for graphics devices that the button below installed"),
            ("FOLDER", "A Folder", "One that you installed yourself: pip install --target FOLDER torch"),
        ),
        default="BUNDLED",
    )
    pytorch_folder: StringProperty(
        name="Folder", description="What `pip install --target` filled, by the same Python version", subtype="DIR_PATH"
    )
    multiview_folder: StringProperty(
        name="Folder",
        description="Holds diffusers and transformers; leave it empty for those that the button installed",
        subtype="DIR_PATH",
    )
    weights_folder: StringProperty(
        name="Weights",
        description="Where weights go that you import; leave it empty for the extension's own folder",
        subtype="DIR_PATH",
    )
    cache_folder: StringProperty(
        name="Cache",
        description="Where downloads are kept for the next time; leave it empty for the extension's own folder",
        subtype="DIR_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        draw_setup(self.layout, self)


register, unregister = bpy.utils.register_classes_factory((ARM_preferences,))
