"""A network that cuts objects out of photographs better than what ships, at the press of a button."""

from pathlib import Path

import bpy

from ...errors import ArmError
from ...machine import libraries, library_install
from ...progress import Progress, part
from ..input import view_list
from ..setup import background, runtime
from ..setup.operators import NO_LIST, WhileOnline
from ..setup.stored import user_folder

_LIBRARY = 0.1
"""Of the progress, what the library takes that runs the network."""


def wants_matting(message: str) -> bool:
    """Whether an error or a doubt would not be there with a better mask."""
    return "get a matting model" in message or "Doubtful: the mask of " in message


def get_matting(lock: Path | None, parent: Path, cache: Path, progress: Progress) -> None:
    """Install what runs a matting model, unless that is there, and download one. On a worker thread: no bpy here.

    Args:
        lock: the list of libraries; None where they are there.
        parent: the folder of libraries is made in it.
        cache: of their downloads.
    Raises:
        ArmError: as `library_install.install` and `weight_files.install.download`.
    """
    if lock is not None:
        folder = library_install.install(lock, parent, part(progress, 0.0, _LIBRARY), cache)
        libraries.add_folder(folder, runtime.MODULES[runtime.MATTING])
    progress(_LIBRARY, "the matting model")
    from ...weight_files import install

    install.download(runtime.MATTING, part(progress, _LIBRARY, 1.0))


class ARM_OT_get_matting_model(WhileOnline, bpy.types.Operator):
    """Download a U2-Net, which cuts objects out of photographs, and onnxruntime, which runs it, into the extension's
    own folders"""

    bl_idname = "arm.get_matting_model"
    bl_label = "Get Matting Model"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self, width=420)

    def draw(self, context: bpy.types.Context) -> None:
        from ...weight_files.registry import REGISTRY

        for entry in (entry for entry in REGISTRY if entry.name == runtime.MATTING):
            self.layout.label(text=f"U2-Net: {entry.download}; and onnxruntime, where it is missing")
            self.layout.label(text=f"Licence: {entry.licence}. By downloading you accept it.", icon="INFO")

    def execute(self, context: bpy.types.Context) -> set[str]:
        lock = library_install.lock_of(runtime.MATTING) if libraries.missing(libraries.MATTING) else None
        try:
            runtime.prepare()
            if lock is None and libraries.missing(libraries.MATTING):
                raise ArmError(NO_LIST)
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        parent, cache = user_folder("libraries"), user_folder("cache")
        background.start(lambda progress: get_matting(lock, parent, cache, progress), _done)
        return self._concluded()


def _done(nothing: None) -> None:
    """On the main thread: the views are cut out anew."""
    runtime.activate()
    bpy.context.window_manager.arm.error = ""
    view_list.look_soon(bpy.context)


register, unregister = bpy.utils.register_classes_factory((ARM_OT_get_matting_model,))
