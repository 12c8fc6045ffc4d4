from .arm_blender import register, unregister  # noqa: F401  # Blender's entry: an extension's root must be a package.
