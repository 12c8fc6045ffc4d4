"""The buttons of the preferences: install libraries, bring weights. Thin wrappers: the work is done elsewhere."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import bpy
from bpy.props import EnumProperty, StringProperty

from ...errors import ArmError
from ...machine import library_install
from ...progress import Progress
from . import background, runtime
from .stored import preferences, user_folder

if TYPE_CHECKING:  # It brings what downloads need.
    from ...weight_files.registry import Weights

OFFLINE = "Blender is offline; allow online access in Preferences > System > Network"
NO_LIST = "There is no list of wheels for this platform and Python; name a folder that holds the libraries instead"
BUSY = "Something else is being done"

EXTRAS = EnumProperty(
    name="Libraries",
    description="What they are for",
    items=(
        (runtime.TORCH, "PyTorch (GPU)", "PyTorch with CUDA"),
        (runtime.PHOTOS, "Photographs", "pycolmap, pillow-heif and PyAV"),
        (runtime.MATTING, "Matting Model", "onnxruntime"),
        (runtime.MULTIVIEW, "Six Views from One Picture", "diffusers, transformers and what they need"),
    ),
    options={"SKIP_SAVE"},
)


class WeightsRow(NamedTuple):
    """One line of the list of weights: an entry of the registry, and how it lies where."""

    entry: "Weights"
    condition: str
    path: Path


_weights: tuple[WeightsRow, ...] | None = None


def weights() -> tuple[WeightsRow, ...] | None:
    """The list as it was last read; None where it was not."""
    return _weights


class WhileIdle:
    """An operator that waits until no other work of the preferences is going on."""

    # Of `bpy.types.Operator`, which every operator that takes this in is besides.
    poll_message_set: ClassVar[Callable[[str], None]]
    report: Callable[[set[str], str], None]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if background.progress() is not None:
            cls.poll_message_set(BUSY)
            return False
        return True

    def _listed(self, work: Callable[[Progress], tuple[WeightsRow, ...]]) -> set[str]:
        """What the operator returns once work that ends in the list of weights was started, or a library is missing."""
        try:
            runtime.prepare()
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        background.start(work, _show_weights)
        return self._concluded()

    def _concluded(self) -> set[str]:
        """What the operator returns once its work was started: without a window that work has ended."""
        if bpy.app.background and background.error():
            self.report({"ERROR"}, background.error())
            return {"CANCELLED"}
        return {"FINISHED"}


class WhileOnline(WhileIdle):
    """As `WhileIdle`, where Blender may go online."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not bpy.app.online_access:
            cls.poll_message_set(OFFLINE)
            return False
        return super().poll(context)


class ARM_OT_install_libraries(WhileOnline, bpy.types.Operator):
    """Download libraries from the Python package index into the extension's own folder; each file's hash is checked"""

    bl_idname = "arm.install_libraries"
    bl_label = "Install Libraries"

    extra: EXTRAS

    def execute(self, context: bpy.types.Context) -> set[str]:
        extra, lock = self.extra, library_install.lock_of(self.extra)
        if lock is None:
            self.report({"ERROR"}, NO_LIST)
            return {"CANCELLED"}
        libraries, cache = user_folder("libraries"), user_folder("cache")

        def done(folder: Path) -> None:
            if extra == runtime.TORCH and (stored := preferences()) is not None:
                stored.pytorch_source = "INSTALLED"

        background.start(lambda progress: library_install.install(lock, libraries, progress, cache), done)
        return self._concluded()


class ARM_OT_remove_libraries(WhileIdle, bpy.types.Operator):
    """Delete the libraries that the button installed"""

    bl_idname = "arm.remove_libraries"
    bl_label = "Remove Libraries"

    extra: EXTRAS

    def execute(self, context: bpy.types.Context) -> set[str]:
        lock = library_install.lock_of(self.extra)
        if lock is None or runtime.installed(self.extra) is None:
            self.report({"ERROR"}, "Nothing is installed")
            return {"CANCELLED"}
        try:
            library_install.remove(lock, user_folder("libraries"))
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        stored = preferences()
        if self.extra == runtime.TORCH and stored is not None and stored.pytorch_source == "INSTALLED":
            stored.pytorch_source = "BUNDLED"
        return {"FINISHED"}


class ARM_OT_list_weights(WhileIdle, bpy.types.Operator):
    """Show the networks' weights: what there is, whether it is whole, under which licence, and what it enables"""

    bl_idname = "arm.list_weights"
    bl_label = "Show Weights"

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._listed(_read_weights)


class ARM_OT_import_weights(WhileIdle, bpy.types.Operator):
    """Convert weights of another project that you have downloaded; code in the file is never run"""

    bl_idname = "arm.import_weights"
    bl_label = "Import Weights"

    filepath: StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    kind: EnumProperty(
        name="Network",
        description="Which network the weights are of",
        items=(
            ("auto", "By the File's Name", "For files that are named as their publishers name them"),
            ("georm", "Shape: InstantMesh", "Its instant_nerf or instant_mesh checkpoint, for the preset InstantMesh"),
            ("image-encoder", "Image Encoder: DINO ViT-B/16", "What training the paper's GeoRM begins with"),
            (
                "material-encoder",
                "Material Encoder: DINO ViT-B/8",
                "What training the paper's InstantAlbedo begins with",
            ),
            ("matting", "Foreground: U2-Net or IS-Net", "An ONNX model that cuts the object out of a photograph"),
        ),
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        source, kind = Path(bpy.path.abspath(self.filepath)), self.kind

        def work(progress: Progress) -> tuple[WeightsRow, ...]:
            progress(0.0, f"Converting {source.name}")
            from ...weight_files.install import install

            for _ in install(source, None if kind == "auto" else kind):
                progress(0.5, f"Converting {source.name}")
            return _read_weights(progress)

        return self._listed(work)


class ARM_OT_download_weights(WhileOnline, bpy.types.Operator):
    """Download weights from those who publish them; what has arrived when it is stopped is gone on with"""

    bl_idname = "arm.download_weights"
    bl_label = "Download Weights"

    name: StringProperty(name="Weights", description="Which weights to download", options={"SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self, width=420)

    def draw(self, context: bpy.types.Context) -> None:
        for entry in (row.entry for row in weights() or () if row.entry.name == self.name):
            self.layout.label(text=f"{entry.name}: {entry.download}")
            self.layout.label(text=f"Licence: {entry.licence}. By downloading you accept it.", icon="INFO")

    def execute(self, context: bpy.types.Context) -> set[str]:
        name = self.name

        def work(progress: Progress) -> tuple[WeightsRow, ...]:
            from ...weight_files import install

            install.download(name, progress)
            return _read_weights(progress)

        return self._listed(work)


class ARM_OT_cancel_setup(bpy.types.Operator):
    """Stop what the preferences are doing"""

    bl_idname = "arm.cancel_setup"
    bl_label = "Cancel"

    def execute(self, context: bpy.types.Context) -> set[str]:
        background.cancel()
        return {"FINISHED"}


def _read_weights(progress: Progress) -> tuple[WeightsRow, ...]:
    """Look at every file of the registry. Runs on a thread: files are read whole, and PyTorch is imported."""
    progress(0.0, "Looking at the weights")
    from ...weight_files import checkpoints
    from ...weight_files.registry import REGISTRY

    rows = []
    for index, entry in enumerate(REGISTRY):
        progress(index / len(REGISTRY), f"Checking {entry.name}")
        rows.append(WeightsRow(entry, checkpoints.condition(entry.name), checkpoints.shipped(entry.name)))
    return tuple(rows)


def _show_weights(rows: tuple[WeightsRow, ...]) -> None:
    global _weights
    _weights = rows


classes = (
    ARM_OT_install_libraries,
    ARM_OT_remove_libraries,
    ARM_OT_list_weights,
    ARM_OT_import_weights,
    ARM_OT_download_weights,
    ARM_OT_cancel_setup,
)

register, _unregister_classes = bpy.utils.register_classes_factory(classes)


def unregister() -> None:
    global _weights
    background.stop()
    _weights = None
    _unregister_classes()
