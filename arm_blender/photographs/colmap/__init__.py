"""COLMAP, by pycolmap in a process of its own: what it is asked for, and what it answers."""
