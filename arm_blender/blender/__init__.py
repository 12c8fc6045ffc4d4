"""Everything that touches Blender's data or window.

`asset/` turns assets into objects and files, `relight/` into pictures, whether or not the extension is registered.
`materials/` lets the artist set the finish of their regions.
`input/` reads what the panel, the scene's cameras and the selected mesh say, `generate/` runs the pipeline on it and
brings the answer into the scene, `setup/` holds the preferences and puts them into effect. Blender may be called from
its main thread only; `job`, `generate.generation` and `input.looking`, which know nothing of bpy, run elsewhere.
"""

from types import ModuleType

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


def _modules() -> tuple[ModuleType, ...]:
    """What is registered, in this order: an operator's module after that of the properties that it reads."""
    from . import cli
    from .asset import export_operator, view_switch
    from .generate import (
        compare_operator,
        draw_views_operator,
        mask_operators,
        matting_operator,
        operators,
        photograph_rows,
        properties,
        recall,
        result_panel,
        solve_cameras_operator,
    )
    from .generate import panel as panels
    from .input import choose_operator, example_operator
    from .input import operators as input_operators
    from .materials import operators as material_operators
    from .materials import panel as material_panel
    from .materials import pick_operator, swatches
    from .materials import properties as material_properties
    from .relight import operators as relight_operators
    from .relight import panel as relight_panel
    from .relight import properties as relight_properties
    from .setup import operators as setup_operators
    from .setup import preferences, runtime

    setup = (preferences, runtime, setup_operators)
    photographs = (choose_operator, solve_cameras_operator, mask_operators, matting_operator, photograph_rows)
    runs = (operators, input_operators, example_operator, draw_views_operator, *photographs)
    making = (properties, view_switch, *setup, *runs, recall, panels, result_panel)
    finishing = (material_properties, swatches, material_operators, pick_operator, material_panel)
    relighting = (relight_properties, relight_operators, compare_operator, export_operator, relight_panel)
    return (*making, *finishing, *relighting, cli)
