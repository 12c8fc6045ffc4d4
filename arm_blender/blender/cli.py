"""`blender --command arm ...`: the words of `python -m arm_blender`, inside Blender."""

import sys

import bpy

from ..errors import ArmError
from .runtime import activate

COMMAND = "arm"

_handle: object | None = None


def run(argv: list[str]) -> int:
    """Answer the command; the result is the exit status of Blender."""
    from ..__main__ import main

    try:
        activate()  # What is missing then, `doctor` says.
    except ArmError as error:
        print(f"arm: {error}", file=sys.stderr)
        return 1
    return main(argv)


def register() -> None:
    global _handle
    _handle = bpy.utils.register_cli_command(COMMAND, run)


def unregister() -> None:
    global _handle
    bpy.utils.unregister_cli_command(_handle)
    _handle = None
