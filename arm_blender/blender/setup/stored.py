"""Where the extension's preferences are found: an extension's name depends on the repository it is in."""

from pathlib import Path

import bpy

BASE_PACKAGE = ".".join(__package__.split(".")[:-3]) or __package__.partition(".")[0]
"""`bl_ext.<repository>.arm_blender` in an extension; the package itself where it runs from its sources."""


def preferences() -> bpy.types.AddonPreferences | None:
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
