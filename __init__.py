"""Blender's entry: an extension's root must be a package."""

# A checkout in a folder whose name is no package's, such as `arm-for-blender`, is imported without one by pytest.
if __package__:
    from .arm_blender import register, unregister  # noqa: F401
