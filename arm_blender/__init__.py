"""ARM for Blender: from pictures of an object to a textured, relightable mesh.

Importing this package imports neither torch nor bpy; Blender calls `register` and `unregister`.
"""

import os

# Beside another busy process OpenMP's waiting threads burn the core that the working ones need: `generate` took 45 s
# instead of 21 s on two cores of which one was taken. It is read once, when torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def register() -> None:
    """Add the panel, the operators, the preferences and the `arm` command to Blender."""
    from .blender import register as register_in_blender

    register_in_blender()


def unregister() -> None:
    """Take everything that `register` added out of Blender again; a running job is stopped first."""
    from .blender import unregister as unregister_from_blender

    unregister_from_blender()
