"""The panel that generates: the run on its thread, and its result in the scene."""
