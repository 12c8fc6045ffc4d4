"""Start and stop a generation. Thin wrappers: the work is in `generation`, the thread in `job`."""

import logging
from functools import partial
from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..errors import ArmError, Cancelled
from . import runtime
from .generation import GenerationRequest, generate
from .job import Job

logger = logging.getLogger(__name__)

_TICK = 0.1
"""Seconds between two looks at the job."""
_QUIT_PATIENCE = 10.0
"""Seconds that closing a file or quitting waits for the thread; quitting under a running thread aborts Blender."""

_running: Job | None = None


class ARM_OT_generate(bpy.types.Operator):
    """Turn the views into a textured, relightable mesh"""

    bl_idname = "arm.generate"
    bl_label = "Generate"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(
        name="Views",
        description="One image or a folder of views, instead of those that the panel names",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )

    _request: GenerationRequest
    _job: Job
    _timer: bpy.types.Timer | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if _running is not None:
            cls.poll_message_set("A generation is running")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window, and from scripts: returns when the object is there."""
        if not self._prepare(context):
            return {"CANCELLED"}
        self._job.start().join()
        return self._conclude(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """From the panel: the work runs on, Blender stays usable."""
        if bpy.app.background:  # Timers never fire there.
            return self.execute(context)
        if not self._prepare(context):
            return {"CANCELLED"}
        global _running
        _running = self._job.start()
        manager = context.window_manager
        manager.arm.fraction, manager.arm.message = 0.0, "Starting"
        self._timer = manager.event_timer_add(_TICK, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            self._job.cancel()
            context.window_manager.arm.message = "Cancelling"
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        report = self._job.latest()
        if report is not None:
            self._show(context, *report)
        if not self._job.finished:
            return {"PASS_THROUGH"}
        self._release(context)
        return self._conclude(context)

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender calls this before it loads another file and when it quits."""
        self._job.cancel()
        if not self._job.join(_QUIT_PATIENCE):
            logger.warning("the generation did not stop within %s s", _QUIT_PATIENCE)
        self._release(context)

    def _prepare(self, context: bpy.types.Context) -> bool:
        views = self.filepath or context.scene.arm.views_path
        if not views:
            self.report({"ERROR"}, "Choose an image or a folder of views first")
            return False
        try:
            runtime.prepare()
        except ArmError as error:
            self.report({"ERROR"}, str(error))
            return False
        self._request = _request_from(context, Path(bpy.path.abspath(views)))
        self._job = Job(partial(generate, self._request))
        return True

    def _show(self, context: bpy.types.Context, fraction: float, message: str) -> None:
        manager = context.window_manager
        manager.arm.fraction, manager.arm.message = fraction, message
        manager.progress_update(int(100 * fraction))
        context.workspace.status_text_set(f"{message}  |  Esc: cancel")
        redraw_views(context)

    def _release(self, context: bpy.types.Context) -> None:
        global _running
        _running = None
        manager = context.window_manager
        manager.event_timer_remove(self._timer)
        manager.progress_end()
        manager.arm.fraction, manager.arm.message = 0.0, ""
        if context.workspace is not None:  # None while Blender quits.
            context.workspace.status_text_set(None)
        redraw_views(context)

    def _conclude(self, context: bpy.types.Context) -> set[str]:
        """Build the object on the main thread, or say why there is none."""
        job = self._job
        if isinstance(job.error, Cancelled):
            self.report({"INFO"}, "Generation cancelled")
            return {"CANCELLED"}
        if job.error is not None:
            self.report({"ERROR"}, str(job.error))
            return {"CANCELLED"}
        if job.failure is not None:
            logger.error("%s", job.failure)
            self.report({"ERROR"}, f"Internal error: {job.failure.strip().splitlines()[-1]} (see the console)")
            return {"CANCELLED"}
        from .scene import build_object, place  # Imports torch, which the worker has loaded by now.

        asset, report = job.result
        created = build_object(asset, self._request.as_settings() | {"report": report.as_dict()})
        place(created, context.scene.arm.placement)
        self.report({"INFO"}, f"{created.name}: {len(created.data.polygons)} faces")
        return {"FINISHED"}


class ARM_OT_cancel(bpy.types.Operator):
    """Stop the running generation"""

    bl_idname = "arm.cancel"
    bl_label = "Cancel Generation"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _running is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        _running.cancel()
        context.window_manager.arm.message = "Cancelling"
        return {"FINISHED"}


def is_running() -> bool:
    """A generation runs on its thread."""
    return _running is not None


def redraw_views(context: bpy.types.Context) -> None:
    """Ask every 3D view to draw its panels anew."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def _request_from(context: bpy.types.Context, views: Path) -> GenerationRequest:
    settings = context.scene.arm
    return GenerationRequest(
        views=views,
        preset=settings.preset,
        quality=settings.quality,
        texture_size=None if settings.texture_size == "AUTO" else int(settings.texture_size),
        faces=settings.faces or None,
        seed=settings.seed,
        device=runtime.device(),
        threads=runtime.threads(),
    )


classes = (ARM_OT_generate, ARM_OT_cancel)


def register() -> None:
    for cls in classes:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Stop a running job first: its thread must not outlive the code that it runs."""
    global _running
    if _running is not None:
        _running.cancel()
        _running.join(_QUIT_PATIENCE)
        _running = None
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
