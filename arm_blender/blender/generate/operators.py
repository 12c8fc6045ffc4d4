"""Start and stop a run. Thin wrappers: the work is in `generation`, the thread in `job`, the request in `request`."""

import logging
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import bpy
from bpy.props import StringProperty

from ...errors import ArmError, Cancelled
from ...progress import Progress
from ..input import mask_painting, request, view_list
from ..input.generation_request import GenerationRequest
from ..job import Job
from ..layout import redraw_sidebars
from ..setup import runtime
from .generation import Generated, generate
from .hiding import hider_of
from .remaining import Remaining, clock

logger = logging.getLogger(__name__)

_TICK = 0.1
"""Seconds between two looks at the job."""
_QUIT_PATIENCE = 10.0
"""Seconds that closing a file or quitting waits for the thread; quitting under a running thread aborts Blender."""

_running: Job[Any] | None = None
_unfinished: list[Job[Any]] = []
"""Cancelled jobs whose threads were still in one long step when Blender went on without them."""


class Run:
    """What every operator with a long run does; its own are the request and what becomes of the result."""

    bl_options = {"REGISTER", "UNDO"}

    _request: GenerationRequest
    _job: Job[Any]
    _remaining: Remaining
    _timer: bpy.types.Timer | None = None

    # Of `bpy.types.Operator`, which every operator that takes this in is besides.
    poll_message_set: ClassVar[Callable[[str], None]]
    report: Callable[[set[str], str], None]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if _running is not None:
            cls.poll_message_set("A generation is running")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window, and from scripts: returns when the result is there."""
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
        manager.arm.fraction, manager.arm.message, manager.arm.time = 0.0, "Starting", ""
        self._timer = manager.event_timer_add(_TICK, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            _cancel(context, self._job)
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        self._show(context)
        if not self._job.finished:
            return {"PASS_THROUGH"}
        self._release(context)
        return self._conclude(context)

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender calls this before it loads another file and when it quits."""
        self._job.cancel()
        if not self._job.join(_QUIT_PATIENCE):
            logger.warning("the generation did not stop within %s s", _QUIT_PATIENCE)
            _unfinished.append(self._job)
        self._release(context)

    def _prepare(self, context: bpy.types.Context) -> bool:
        context.window_manager.arm.error = ""
        try:
            runtime.prepare()
            mask_painting.save_painted()  # What is seen is what is used.
            wanted = self._wanted(context)
        except ArmError as error:
            self._fail(context, str(error))
            return False
        self._request = wanted
        self._remaining = Remaining(self._networks(wanted), wanted.quality, wanted.mesh is not None)
        self._job = Job(self._work(wanted))
        return True

    def _wanted(self, context: bpy.types.Context) -> GenerationRequest:
        """What is asked for.

        Raises:
            ArmError: it cannot be done; nothing runs.
        """
        raise NotImplementedError

    def _networks(self, wanted: GenerationRequest) -> str:
        """What the seconds that are left are guessed by."""
        return wanted.preset

    def _work(self, wanted: GenerationRequest) -> Callable[[Progress], Any]:
        """What runs on the thread."""
        return partial(generate, wanted)

    def _deliver(self, context: bpy.types.Context, made: Any) -> str:
        """Bring what the work returned into the file, on the main thread.

        Returns:
            What the user is told.
        Raises:
            ArmError: the file has changed meanwhile.
        """
        raise NotImplementedError

    def _show(self, context: bpy.types.Context) -> None:
        manager, job = context.window_manager, self._job
        before = manager.arm.fraction, manager.arm.message, manager.arm.time
        report = job.latest()
        if report is not None:
            manager.arm.fraction = report[0]
            manager.progress_update(int(100 * report[0]))
        if not job.cancelled:  # Reports that were under way must not hide that the wish was heard.
            if report is not None:
                manager.arm.message = report[1]
            left = self._remaining.seconds(manager.arm.fraction, job.elapsed)
            guess = "" if left is None else f", about {clock(left)} left"
            manager.arm.time = f"{clock(job.elapsed)}{guess}"
        if before != (manager.arm.fraction, manager.arm.message, manager.arm.time):
            if not job.cancelled:
                context.workspace.status_text_set(f"{manager.arm.message}  |  {manager.arm.time}  |  Esc: cancel")
            redraw_sidebars(context)

    def _release(self, context: bpy.types.Context) -> None:
        global _running
        _running = None
        manager = context.window_manager
        manager.event_timer_remove(self._timer)
        manager.progress_end()
        manager.arm.fraction, manager.arm.message, manager.arm.time = 0.0, "", ""
        if context.workspace is not None:  # None while Blender quits.
            context.workspace.status_text_set(None)
        redraw_sidebars(context)

    def _conclude(self, context: bpy.types.Context) -> set[str]:
        """Bring the result into the scene on the main thread, or say why there is none."""
        job = self._job
        if isinstance(job.error, Cancelled):
            self.report({"INFO"}, "Generation cancelled")
            return {"CANCELLED"}
        if job.failure is not None:
            logger.error("%s", job.failure)
            return self._fail(context, f"Internal error: {job.failure.strip().splitlines()[-1]} (see the console)")
        try:
            if job.error is not None:
                raise job.error
            self.report({"INFO"}, self._deliver(context, job.result))
        except ArmError as error:
            logger.info("the run failed", exc_info=error)
            return self._fail(context, str(error))
        return {"FINISHED"}

    def _fail(self, context: bpy.types.Context, message: str) -> set[str]:
        """Say it once in Blender's own way, and keep it in the panel until the next run."""
        context.window_manager.arm.error = message
        self.report({"ERROR"}, message)
        return {"CANCELLED"}


class ARM_OT_generate(Run, bpy.types.Operator):
    """Turn the views into a textured, relightable mesh"""

    bl_idname = "arm.generate"
    bl_label = "Generate"

    filepath: StringProperty(
        name="Views",
        description="One image or a folder of views, instead of those that the panel names",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )

    def _wanted(self, context: bpy.types.Context) -> GenerationRequest:
        return request.from_panel(context, self.filepath)

    def _deliver(self, context: bpy.types.Context, made: Generated) -> str:
        from .results import add_result  # Imports torch, which the worker has loaded by now.

        created = add_result(context, made, self._request)
        if context.scene.arm.views_kind == "photographs":
            view_list.look_soon(context)  # By now it is known what became of each.
        hider, state = hider_of(context, created), context.window_manager.arm
        state.newest, state.hidden_by = created.name, "" if hider is None else hider.name
        hidden = "" if hider is None else f"; {hider.name} hides it: press / to see it alone"
        return f"{created.name}: {len(created.data.polygons)} faces{hidden}"


class ARM_OT_regenerate(Run, bpy.types.Operator):
    """Make the appearance of the active result anew, with the ticks and weights of its views; the shape stays"""

    bl_idname = "arm.regenerate"
    bl_label = "Regenerate Appearance"

    def _wanted(self, context: bpy.types.Context) -> GenerationRequest:
        return request.from_result(context)

    def _deliver(self, context: bpy.types.Context, made: Generated) -> str:
        from .results import renew_appearance

        return f"{renew_appearance(made, self._request).name}: new appearance"


class ARM_OT_cancel(bpy.types.Operator):
    """Stop the running generation"""

    bl_idname = "arm.cancel"
    bl_label = "Cancel Generation"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _running is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        assert _running is not None  # As `poll` says.
        _cancel(context, _running)
        return {"FINISHED"}


def _cancel(context: bpy.types.Context, job: Job[Any]) -> None:
    """Ask the job to stop, and show at once that this was heard."""
    job.cancel()
    state = context.window_manager.arm
    state.message, state.time = "Cancelling", ""
    context.workspace.status_text_set("Cancelling")
    redraw_sidebars(context)


def is_running() -> bool:
    """A generation runs on its thread."""
    return _running is not None


def stop_all() -> None:
    """Cancel what runs, and wait for every thread of ours."""
    global _running
    if _running is not None:
        _running.cancel()
        _unfinished.append(_running)
        _running = None
    for job in _unfinished:
        job.join(_QUIT_PATIENCE)
    _unfinished.clear()


classes = (ARM_OT_generate, ARM_OT_regenerate, ARM_OT_cancel)

register, _unregister_classes = bpy.utils.register_classes_factory(classes)


def unregister() -> None:
    """Stop a running job first: its thread must not outlive the code that it runs."""
    stop_all()
    _unregister_classes()
