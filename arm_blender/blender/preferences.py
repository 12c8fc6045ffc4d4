"""The extension's preferences, and where they are found: an extension's name depends on the repository it is in."""

from pathlib import Path

import bpy
from bpy.props import EnumProperty, IntProperty, StringProperty

BASE_PACKAGE = __package__.rpartition(".")[0].rpartition(".")[0] or __package__.partition(".")[0]
"""`bl_ext.<repository>.arm_blender` in an extension; the package itself where it runs from its sources."""


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
        from .setup_layout import draw_setup  # It asks for these preferences, so it cannot be imported before them.

        draw_setup(self.layout, self)


def preferences() -> ARM_preferences | None:
    """The user's preferences; None where the package is not enabled as an add-on."""
    addon = bpy.context.preferences.addons.get(BASE_PACKAGE)
    return None if addon is None else addon.preferences


def user_folder(kind: str) -> Path:
    """The extension's own folder for "libraries", "weights" or "cache", which stays when it is updated.

    It need not exist.
    """
    chosen = getattr(preferences(), f"{kind}_folder", "")
    if chosen:
        return Path(bpy.path.abspath(chosen))
    if BASE_PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(BASE_PACKAGE, path=kind))
    return Path(bpy.utils.user_resource("DATAFILES", path=f"{BASE_PACKAGE}/{kind}"))


def register() -> None:
    bpy.utils.register_class(ARM_preferences)


def unregister() -> None:
    bpy.utils.unregister_class(ARM_preferences)
