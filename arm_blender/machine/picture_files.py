"""Which files are pictures and which are videos, by their names: for those who choose before anything is read."""

from pathlib import Path

HEIF_SUFFIXES = (".heic", ".heif")
"""Pictures of phones that need the library pillow-heif."""

SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".webp", ".hdr", ".tif", ".tiff", *HEIF_SUFFIXES)
"""Of the pictures that are read."""

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v")
"""What counts as a video."""


def is_video(path: Path) -> bool:
    """Whether a path is a video by its name."""
    return path.suffix.lower() in VIDEO_SUFFIXES


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder, sorted by name; hidden files and sub-folders do not count."""
    found = (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.name[0] != ".")
    return sorted(path for path in found if path.is_file())
