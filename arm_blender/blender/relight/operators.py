"""Render the active object under environments, and light the scene by one. Thin wrappers around `relight`."""

import math
from collections.abc import Sequence
from pathlib import Path

import bpy
from bpy.props import EnumProperty

from ...errors import ArmError
from ..asset.predicted_light import light_file
from .callbacks import FROM_FILE, FROM_VIEWS

PICTURE = "ARM Relight"
"""The image of the open file that shows the newest render."""

_TICK = 0.1
"""Seconds between two pictures, in which Blender draws and hears Esc."""


class ARM_OT_relight(bpy.types.Operator):
    """Render the active object under the chosen environment; Esc stops after the picture that is underway"""

    bl_idname = "arm.relight"
    bl_label = "Relight"

    what: EnumProperty(
        name="What",
        description="One picture, or one full turn",
        items=(("STILL", "Still", "One picture"), ("SEQUENCE", "Sequence", "One full turn, and its video")),
        default="STILL",
        options={"SKIP_SAVE"},
    )

    _timer: bpy.types.Timer | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not can_be_relit(context.active_object):
            cls.poll_message_set("Select a mesh with faces")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """From scripts and without a window: returns when all pictures are there."""
        try:
            self._prepare(context)
            while self._waiting:
                self._render_next()
            return self._conclude(context)
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """From the panel: Blender is usable between two pictures."""
        if bpy.app.background or self.what == "STILL":
            return self.execute(context)
        try:
            self._prepare(context)
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(_TICK, window=context.window)
        manager.progress_begin(0, len(self._waiting))
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"INFO"}, f"Stopped after {len(self._done)} pictures; they stay in {self._output}")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            if self._waiting:
                self._render_next()
                context.window_manager.progress_update(len(self._done))
                left = len(self._waiting)
                context.workspace.status_text_set(f"Relighting: {len(self._done)} done, {left} to go  |  Esc: stop")
                return {"RUNNING_MODAL"}
            result = self._conclude(context)
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            result = {"CANCELLED"}
        self.cancel(context)
        return result

    def cancel(self, context: bpy.types.Context) -> None:
        """Also called by Blender before it loads another file and when it quits."""
        manager = context.window_manager
        manager.event_timer_remove(self._timer)
        manager.progress_end()
        if context.workspace is not None:  # None while Blender quits.
            context.workspace.status_text_set(None)

    def _prepare(self, context: bpy.types.Context) -> None:
        """Reads what the user chose; anything that is missing is said before the first picture."""
        from .graphics_device import check_eevee
        from .renders import RelightConfig, frames

        settings = context.scene.arm_relight
        self._source = context.active_object.name
        self._output = output_folder(settings.output)
        self._done: list[Path] = []
        self._config = RelightConfig(
            settings.engine,
            settings.resolution,
            settings.samples,
            1 if self.what == "STILL" else settings.turntable,
            settings.turning,
            math.degrees(settings.rotation),
        )
        shown = context.active_object
        chosen = [_environment(settings.environment, settings.environment_file, shown)]
        if settings.compare:
            chosen.append(_environment(settings.second, settings.second_file, shown))
        self._waiting = frames(chosen, self._config, compare=settings.compare)
        if self._config.engine == "eevee":
            check_eevee()

    def _render_next(self) -> None:
        """One picture in a scene of its own: nothing is held in between, when the user may undo or delete."""
        from .renders import render_frames

        source = bpy.data.objects.get(self._source)
        if source is None:
            raise ArmError(f"{self._source}: is gone; {len(self._done)} pictures are in {self._output}")
        self._done += render_frames(source, [self._waiting.pop(0)], self._output, self._config)

    def _conclude(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.arm_relight
        files = list(self._done)
        if self.what == "SEQUENCE" and settings.video:
            from .video import write_video

            files.append(files[0].with_name(f"{files[0].stem.rpartition('_')[0]}.mp4"))
            write_video(files[-1], self._done, settings.frames_per_second)
        show_picture(context, self._done[-1])
        self.report({"INFO"}, f"{files[-1]}" if len(files) == 1 else f"{len(files)} files in {self._output}")
        return {"FINISHED"}


class ARM_OT_light_scene(bpy.types.Operator):
    """Light the scene by the chosen environment; the world that it had stays in the file"""

    bl_idname = "arm.light_scene"
    bl_label = "Light Scene"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..asset.studio import light_by_environment, pack_environment
        from .environments import environment_path

        settings = context.scene.arm_relight
        before = context.scene.world
        try:
            chosen = _environment(settings.environment, settings.environment_file, context.active_object)
            world = light_by_environment(context.scene, environment_path(chosen), math.degrees(settings.rotation))
            if settings.environment == FROM_VIEWS:  # Its file goes when Blender does.
                pack_environment(world)
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if before is not None:
            before.use_fake_user = True
        return {"FINISHED"}


def can_be_relit(active: bpy.types.Object | None) -> bool:
    """There is something to see of the object."""
    return active is not None and active.type == "MESH" and len(active.data.polygons) > 0


def _environment(name: str, file: str, shown: bpy.types.Object | None) -> str | Path:
    """The chosen environment, as `environment_path` takes it; `shown` is the object whose views' light it may be."""
    if name == FROM_VIEWS:
        return light_file(shown)
    if name != FROM_FILE:
        return name
    if not file:
        raise ArmError("Choose the environment's file first")
    return bpy.path.abspath(file)


def lacks_saved_file(path: str) -> bool:
    """A folder is relative to the open file, which was never saved."""
    return path.startswith("//") and not bpy.data.filepath


def output_folder(path: str) -> Path:
    """The folder that the user named; relative to the open file, which has to be saved for that."""
    if lacks_saved_file(path):
        raise ArmError("Save the file first, or choose a folder that does not begin with //")
    if not path:
        raise ArmError("Choose a folder for the pictures first")
    return Path(bpy.path.abspath(path))


def show_picture(context: bpy.types.Context, picture: Path) -> None:
    """The newest picture as an image of the open file, anew in the panel and in every editor that shows it."""
    image = bpy.data.images.get(PICTURE)
    if image is None:
        image = bpy.data.images.load(str(picture))
        image.name = PICTURE
    else:
        image.filepath = str(picture)
        image.reload()
    image.preview_ensure()
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("VIEW_3D", "IMAGE_EDITOR"):
                area.tag_redraw()


classes: Sequence[type] = (ARM_OT_relight, ARM_OT_light_scene)

register, unregister = bpy.utils.register_classes_factory(classes)
