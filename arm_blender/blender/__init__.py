"""Everything that touches Blender's data or window.

`scene`, `material_nodes`, `export`, `studio` and `relight` turn assets into objects, files and pictures, whether or not
the extension is registered. The other modules are the extension: properties, panel, operators, preferences, command;
`request` reads what they hold, with `own_mesh` and `scene_cameras`, and `results` brings the answer into the scene.
Blender may be called from its main thread only; `job`, `generation` and `looking`, which know nothing of bpy, run
elsewhere.
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
    from . import (
        cli,
        export_operator,
        input_operators,
        operators,
        panels,
        preferences,
        properties,
        relight_operators,
        relight_panel,
        relight_properties,
        runtime,
        setup_operators,
        view_switch,
    )

    making = (properties, view_switch, preferences, runtime, setup_operators, operators, input_operators, panels)
    relighting = (relight_properties, relight_operators, export_operator, relight_panel)
    return (*making, *relighting, cli)
