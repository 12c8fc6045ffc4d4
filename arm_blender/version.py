"""The version of the program; pyproject.toml reads it, and blender_manifest.toml says the same."""

VERSION = "0.2.0"
