"""One folder for all that a program and what it starts put aside: what a kill leaves there, the next one takes away."""

import atexit
import getpass
import os
import tempfile
from contextlib import ExitStack, suppress
from pathlib import Path

from ..errors import OutputError
from .files import staging

_VARIABLES = ("TMPDIR", "TEMP", "TMP")
"""Where Python, Blender and other programs look for the folder of temporary files."""


def keep_temporary_files_together() -> None:
    """From now on temporary files of this process, and of those that it starts, lie in a folder of their own.

    It goes when the process ends. Where that is killed, the next one takes the folder away, as `files.staging` does:
    only folders of ours, and only if no process holds them. To be called once, before Blender is imported, which makes
    a folder at once. Nothing changes where the folder cannot be made.
    """
    stack = ExitStack()
    try:
        place = Path(tempfile.gettempdir(), f"arm-{getpass.getuser()}")
        place.mkdir(mode=0o700, exist_ok=True)
        if place.is_symlink() or (hasattr(os, "getuid") and place.stat().st_uid != os.getuid()):
            return  # Somebody else's: what lies there could be exchanged.
        folder = stack.enter_context(staging(place))
    except (OutputError, OSError, KeyError, ImportError):  # No place left, or a user without a name.
        return
    tempfile.tempdir = str(folder)
    for name in _VARIABLES:
        os.environ[name] = str(folder)
    atexit.register(_end, stack, place)


def _end(stack: ExitStack, place: Path) -> None:
    stack.close()
    with suppress(OSError):  # Others are at work there.
        place.rmdir()
