"""`blender --command arm ...`: the words of `python -m arm_blender`, inside Blender."""

import sys

import bpy

from ..errors import ArmError
from .setup.runtime import activate

COMMAND = "arm"

OFFLINE = (
    "Blender is not allowed to go online; start it with --online-mode or allow it in the preferences under System, "
    "or bring the file and use: weights import FILE"
)

_handle: object | None = None


def run(argv: list[str]) -> int:
    """Answer the command; the result is the exit status of Blender."""
    from ..__main__ import main
    from ..commands import interrupts

    words = [word for word in argv if not word.startswith("-")]
    if words[:2] == ["weights", "download"] and not bpy.app.online_access:
        print(f"arm: {OFFLINE}", file=sys.stderr)
        return 1
    try:
        activate()  # What is missing then, `doctor` says.
    except ArmError as error:
        print(f"arm: {error}", file=sys.stderr)
        return 1
    with interrupts.listening():  # Blender's own way of stopping would leave files half-written.
        return main(argv)


def register() -> None:
    global _handle
    _handle = bpy.utils.register_cli_command(COMMAND, run)


def unregister() -> None:
    global _handle
    bpy.utils.unregister_cli_command(_handle)
    _handle = None
