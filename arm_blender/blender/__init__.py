"""Everything that touches Blender's data or window.

`scene`, `material_nodes`, `export`, `studio` and `relight` turn assets into objects, files and pictures, whether or not
the extension is registered. The other modules are the extension: properties, panel, operators, preferences, command.
Blender may be called from its main thread only; `job` and `generation`, which know nothing of bpy, run elsewhere.
"""

_registered = False


def register() -> None:
    """Add the extension to Blender."""
    global _registered
    import atexit

    from .compat import IS_MODULE

    for module in _modules():
        module.register()
    _registered = True
    if IS_MODULE:  # As a Python module, 4.2 and 4.5 crash or hang at exit while classes are registered.
        atexit.register(unregister)


def unregister() -> None:
    """Take the extension out of Blender; nothing where it is not in."""
    global _registered
    import atexit

    if not _registered:  # At exit Blender disables what is enabled, after `atexit` has been here.
        return
    _registered = False
    atexit.unregister(unregister)
    for module in reversed(_modules()):
        module.unregister()


def _modules() -> tuple:
    from . import cli, operators, panels, preferences, properties, runtime, setup_operators

    return (properties, preferences, runtime, setup_operators, operators, panels, cli)
