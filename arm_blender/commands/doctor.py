"""Show the versions of what the program runs on, and say what is missing and how to get it."""

import argparse
import importlib
import importlib.metadata
import os
import platform

from ..machine.libraries import REQUIRED
from ..version import VERSION

_OPTIONAL = {
    "bpy": ("bpy", "only for .blend files and relighting"),
    "diffusers": ("diffusers", "only for --multiview zero123plus"),
    "transformers": ("transformers", "only for --multiview zero123plus"),
    "onnxruntime": ("onnxruntime", "only for a matting model"),
}
"""What a run does without, and what it then cannot do."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`doctor` takes no words of its own."""


def run(args: argparse.Namespace) -> int:
    print(f"{'arm_blender':<20} {VERSION}")
    print(f"{'python':<20} {platform.python_version()} on {platform.platform()}, {os.cpu_count()} CPU cores")
    missing = 0
    for package, module in REQUIRED.items():
        starts, state = _state(package, module)
        missing += not starts
        print(f"{package:<20} {state}")
    for package, (module, use) in _OPTIONAL.items():
        starts, state = _state(package, module)
        print(f"{package:<20} {state}{'' if starts else f'  ({use})'}")
    if not missing:
        missing += _print_torch_and_weights()
    return 1 if missing else 0


def _state(package: str, module: str) -> tuple[bool, str]:
    """Whether a package starts, and its version or what is wrong with it."""
    try:
        version = importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        version = None
    try:
        importlib.import_module(module)
    except (ImportError, OSError) as error:
        if version is None:
            return False, f"missing; pip install {package}"
        # A system library is not there: the message names it.
        return False, f"{version}, but it does not start: {error}; install that system library"
    return True, version or "built in"


def _print_torch_and_weights() -> int:
    """Devices and weights; the number of weights that `small` lacks."""
    import torch

    from ..errors import CheckpointError
    from ..weight_files import checkpoints
    from ..weight_files.registry import REGISTRY

    devices = ["cpu"]
    if torch.cuda.is_available():
        devices.append(f"cuda ({torch.cuda.get_device_name()})")
    if torch.backends.mps.is_available():
        devices.append("mps")
    print(f"{'devices':<20} {', '.join(devices)}; {torch.get_num_threads()} threads")
    missing = 0
    for weights in REGISTRY:
        path = checkpoints.shipped(weights.name)
        state = "installed" if path.is_file() else f"missing; {weights.remedy}"
        if path.is_file() and path.suffix == checkpoints.SUFFIX:
            try:
                checkpoints.read_header(path)
            except CheckpointError as error:
                state = str(error)
        missing += state != "installed" and weights.name.startswith("small.")
        print(f"{weights.name:<20} {state}")
    return missing
