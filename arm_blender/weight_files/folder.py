"""Where weights lie: beside the code those that ship, in a folder of the user's those that he brings.

Imports nothing heavy: Blender's preferences show it.
"""

import os
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "weights"
"""Of what ships; an update of the program replaces it."""

VARIABLE = "ARM_WEIGHTS"
"""Environment variable: the folder of weights that do not ship. Without it they lie beside those that do."""


def folder_of(name: str) -> Path:
    """The folder of registered weights, such as "small.georm"."""
    brought = "" if name.startswith("small.") else os.environ.get(VARIABLE)
    return Path(brought or FOLDER)
