"""The libraries that the program runs on: whether they are there, and those that lie in a folder of the user's.

Imports the standard library only, and none of the libraries: it runs when Blender starts.
"""

import importlib
import importlib.util
import sys
from collections.abc import Iterable
from pathlib import Path

from ..errors import ArmError

REQUIRED = {
    "torch": "torch",
    "numpy": "numpy",
    "OpenImageIO": "OpenImageIO",
    "xatlas": "xatlas",
    "trimesh": "trimesh",
    "fast-simplification": "fast_simplification",
    "safetensors": "safetensors",
    "pillow": "PIL",
}
"""What every run needs: the name of the package, and of the module to import."""

MULTIVIEW = {"diffusers": "diffusers", "transformers": "transformers"}
"""What drawing six views of one picture needs besides."""

PHOTOS = {"pycolmap": "pycolmap", "pillow-heif": "pillow_heif", "av": "av"}
"""What photographs without cameras, HEIC and videos need besides."""

MATTING = {"onnxruntime": "onnxruntime"}
"""What a network that cuts out the object of a photograph, brought by the user, needs besides."""


def missing(packages: dict[str, str]) -> list[str]:
    """The packages whose modules are not found; nothing is imported."""
    return [package for package, module in packages.items() if not is_there(module)]


def is_there(module: str) -> bool:
    """A module is imported, or would be found."""
    if sys.modules.get(module) is not None:
        return True
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):  # Something half-removed, or None, is in its place.
        return False


def check_folder(folder: Path, modules: Iterable[str]) -> None:
    """Make sure that a folder holds libraries as `pip install --target` lays them down.

    Raises:
        ArmError: a module is not in the folder, or was made for another Python.
    """
    for module in modules:
        package = folder / module
        if not package.is_dir():
            raise ArmError(f"{folder}: has no {module}; name the folder that `pip install --target` filled")
        _check_python(package)


def add_folder(folder: Path, modules: Iterable[str], first: bool = False) -> None:
    """Have Python find the libraries in a folder.

    Args:
        folder: as `check_folder` accepts it.
        modules: what has to be there.
        first: before what Python finds otherwise, where that has another PyTorch; else after it.
    Raises:
        ArmError: as `check_folder`.
    """
    check_folder(folder, modules)
    if str(folder) in sys.path:
        return
    if first:
        # Blender's own numpy stays the one for all add-ons, whatever else the folder holds.
        importlib.import_module("numpy")
        sys.path.insert(0, str(folder))
    else:
        sys.path.append(str(folder))
    importlib.invalidate_caches()


def remove_folder(folder: Path) -> None:
    """Undo `add_folder`; what was imported stays."""
    if str(folder) in sys.path:
        sys.path.remove(str(folder))


def _check_python(package: Path) -> None:
    """Compiled modules name the Python that they were made for.

    Raises:
        ArmError: it is not this one.
    """
    compiled = [path.name for path in package.iterdir() if path.suffix in (".so", ".pyd") and "cp" in path.name]
    own = f"{sys.version_info.major}{sys.version_info.minor}"
    fitting = (f"cpython-{own}-", f".cp{own}-", "abi3")
    if compiled and not any(tag in name for name in compiled for tag in fitting):
        python = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise ArmError(f"{package}: {compiled[0]} is for another Python; install it with Python {python}")
