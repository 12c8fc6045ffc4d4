"""What the preferences say of this machine, put into effect before work begins: libraries, weights, device, threads."""

import os
import sys
from pathlib import Path

import bpy

from ...errors import ArmError
from ...machine import libraries
from ...machine.library_install import folder_of, lock_of
from ...weight_files import folder as weights_folder
from ..compat import find_bundled_libraries
from .stored import preferences, user_folder

TORCH, MULTIVIEW, PHOTOS, MATTING = "torch-gpu", "multiview", "photos", "matting"
"""What can be installed from the preferences, by the name of its list."""

MODULES = {
    TORCH: ("torch",),
    MULTIVIEW: tuple(libraries.MULTIVIEW.values()),
    PHOTOS: tuple(libraries.PHOTOS.values()),
    MATTING: tuple(libraries.MATTING.values()),
}
"""What has to lie in the folder of each."""

NO_TORCH = "PyTorch is missing; Edit > Preferences > Add-ons > ARM Relightable 3D offers ways to get it"

_given_weights = os.environ.get(weights_folder.VARIABLE)
_added: set[Path] = set()
"""Every folder that was put on the search path, whether it still is or not."""


def prepare() -> None:
    """Make ready for work.

    Raises:
        ArmError: a library is missing, or a folder that the preferences name does not do; the line says what to do.
    """
    reason = problem()
    if reason:
        raise ArmError(reason)
    activate()


def problem() -> str:
    """Why nothing can be made on this machine, in one line with the remedy; empty where all is there.

    Cheap enough for a panel: nothing is imported.
    """
    absent = libraries.missing(libraries.REQUIRED)
    folder = folder_for(TORCH)
    if folder is not None:
        try:
            libraries.check_folder(folder, MODULES[TORCH])
        except ArmError as error:
            return str(error)
        absent = [package for package in absent if not (folder / libraries.REQUIRED[package]).exists()]
    if "torch" in absent:
        return NO_TORCH
    if absent:
        return f"{', '.join(absent)}: missing; install the extension's zip that was made for this platform and Python"
    return ""


def activate() -> None:
    """Put the folders that the preferences name into effect; another choice takes the place of an earlier one.

    Raises:
        ArmError: a folder does not hold what it should.
    """
    if preferences() is None:
        return
    os.environ[weights_folder.VARIABLE] = _given_weights or str(user_folder("weights"))
    wanted = {extra: folder for extra in MODULES if (folder := folder_for(extra)) is not None}
    for folder in _added - set(wanted.values()):
        libraries.remove_folder(folder)
    for extra, folder in wanted.items():
        libraries.add_folder(folder, MODULES[extra], first=extra == TORCH)
        _added.add(folder)


def forget() -> None:
    """Undo `activate`."""
    for folder in _added:
        libraries.remove_folder(folder)
    _added.clear()
    os.environ.pop(weights_folder.VARIABLE, None)
    if _given_weights is not None:
        os.environ[weights_folder.VARIABLE] = _given_weights


def folder_for(extra: str) -> Path | None:
    """The folder that the preferences choose for an extra; None where Python finds them by itself."""
    chosen = preferences()
    if chosen is None or (extra == TORCH and chosen.pytorch_source == "BUNDLED"):
        return None
    named = chosen.multiview_folder if extra == MULTIVIEW else ""
    if extra == TORCH:
        named = chosen.pytorch_folder if chosen.pytorch_source == "FOLDER" else ""
        if chosen.pytorch_source == "FOLDER" and not named:
            return None
    return Path(bpy.path.abspath(named)) if named else installed(extra)


def installed(extra: str) -> Path | None:
    """Where the button of the preferences installed an extra; None where it did not, or an older list of it."""
    lock = lock_of(extra)
    if lock is None:
        return None
    folder = folder_of(lock, user_folder("libraries"))
    return folder if folder.is_dir() else None


def has_matting() -> bool:
    """A matting model is there, and what it runs on. Cheap enough for a panel: nothing is imported."""
    brought = _given_weights or ("" if preferences() is None else str(user_folder("weights")))
    place = Path(brought) if brought else weights_folder.folder_of(MATTING)
    runs = not libraries.missing(libraries.MATTING) or folder_for(MATTING) is not None
    return runs and (place / f"{MATTING}.onnx").is_file()


def needs_restart() -> bool:
    """PyTorch is in use, and not the one that the preferences choose: a loaded library cannot be exchanged."""
    folder, torch = folder_for(TORCH), sys.modules.get("torch")
    origin = getattr(torch, "__file__", None)
    if origin is None:
        return False
    if folder is None:
        return any(Path(origin).is_relative_to(other) for other in _added)
    return not Path(origin).is_relative_to(folder)


def device() -> str:
    """ "cpu", "cuda", "mps", or "auto" to be decided where PyTorch is imported."""
    chosen = preferences()
    return "auto" if chosen is None else chosen.device


def threads() -> int:
    """Of the processor, for the networks."""
    chosen = preferences()
    return (chosen.threads if chosen is not None else 0) or max(1, (os.cpu_count() or 2) - 1)


def register() -> None:
    """The folders of the preferences are put into effect when they are needed, and not before."""
    find_bundled_libraries()


def unregister() -> None:
    forget()
