"""Assets as objects, materials and files of Blender."""
