"""The panel's list of views: read on a thread of its own as soon as they are chosen, with a thumbnail of each."""

import logging
from functools import partial

import bpy
import bpy.utils.previews

from ...errors import ArmError, Cancelled
from ..job import Job
from ..layout import redraw_sidebars
from .looking import Look, look
from .request import cameras_key, path_key, views_from_panel, views_key

logger = logging.getLogger(__name__)

_TICK = 0.1
"""Seconds between two looks at the job."""
_QUIT_PATIENCE = 10.0

_job: Job[Look] | None = None
_stopped: list[Job[Look]] = []
"""Cancelled looks whose threads may not have ended."""
_key = ""
_found: tuple[str, Look] | None = None
"""The newest look, and what it is of."""
_previews: bpy.utils.previews.ImagePreviewCollection | None = None


def look_soon(context: bpy.types.Context) -> None:
    """Begin to read the chosen views; without a window nothing is read before it is asked for."""
    settings, state = context.scene.arm, context.window_manager.arm
    stop()
    state.views_error = ""
    if bpy.app.background or (settings.source == "FILES" and not settings.views_path):
        return
    try:
        _begin(context)
    except ArmError as error:
        state.views_error = str(error)
        return
    bpy.app.timers.register(_poll, first_interval=_TICK)


def look_now(context: bpy.types.Context) -> None:
    """Read the chosen views and wait for them.

    Raises:
        ArmError: they do not do.
    """
    stop()
    job = _begin(context)
    job.join()
    _conclude(context, job)


@bpy.app.handlers.persistent
def look_after_undo(*_: object) -> None:
    """The choice that undo or redo brought back is read where it is not what was read last."""
    if not bpy.app.background and not bpy.app.timers.is_registered(_look_again):
        bpy.app.timers.register(_look_again, first_interval=_TICK)  # When Blender is through with its undoing.


def _look_again() -> None:
    if not is_listed(bpy.context) or found(bpy.context) is None:
        look_soon(bpy.context)


def is_listed(context: bpy.types.Context) -> bool:
    """The panel's list is that of the chosen pictures, not of others."""
    settings = context.scene.arm
    if settings.source == "CAMERAS":
        return bool(settings.views_of == cameras_key(context))
    return bool(settings.views_path) and settings.views_of == path_key(settings.views_path)


def is_looking() -> bool:
    """The views are being read."""
    return _job is not None


def found(context: bpy.types.Context) -> Look | None:
    """The newest look, if it is that of the panel's list."""
    return _found[1] if _found is not None and _found[0] == context.scene.arm.views_of else None


def icons(context: bpy.types.Context, index: int) -> tuple[int, int]:
    """The icons of a listed view's picture and of its mask; 0 is none, as for a list that nothing was read for yet."""
    known = {} if _previews is None or found(context) is None else _previews
    picture, mask = (known[name].icon_id if name in known else 0 for name in (f"{index} picture", f"{index} mask"))
    return picture, mask


def stop() -> None:
    """Cancel a look that is going on; its thread ends at its next report."""
    global _job
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
    _stopped[:] = [job for job in _stopped if not job.finished]
    if _job is not None:
        _job.cancel()
        _stopped.append(_job)
        _job = None


def _begin(context: bpy.types.Context) -> Job[Look]:
    global _job, _key
    request = views_from_panel(context)
    _key = views_key(context, request)
    _job = Job(partial(look, request)).start()
    return _job


def _poll() -> float | None:
    """Runs on the main thread while a look goes on."""
    if _job is None:
        return None
    if not _job.finished:
        return _TICK
    context = bpy.context
    try:
        _conclude(context, _job)
    except ArmError as error:
        context.window_manager.arm.views_error = str(error)
    redraw_sidebars(context)
    return None


def _conclude(context: bpy.types.Context, job: Job[Look]) -> None:
    """Take over what the job, which has ended, has found.

    Raises:
        ArmError: the views do not do.
    """
    global _job, _found
    _job = None
    if isinstance(job.error, Cancelled):
        return
    if job.error is not None:
        raise job.error
    if job.failure is not None:
        logger.error("%s", job.failure)
        raise ArmError(f"{_key}: cannot be read ({job.failure.strip().splitlines()[-1]}); see the console")
    assert job.result is not None  # As it neither was stopped nor failed.
    _found = (_key, job.result)
    _fill(context.scene.arm, job.result)
    _draw_thumbnails(job.result)


def _fill(settings: bpy.types.PropertyGroup, seen: Look) -> None:
    """The list of views; ticks and weights stay where it is the list of the same views."""
    known = settings.views_of == _key and len(settings.views) == len(seen.views)
    if not known:
        settings.views.clear()
    told_of = {told.view: told for told in seen.told}
    for index, view in enumerate(seen.views):
        told = told_of.get(view.name)
        item = settings.views[index] if known else settings.views.add()
        item.name, item.sees = view.name, view.sees
        item.way, item.doubt = (view.way, view.doubt) if told is None else (told.way, told.doubt)
        if not known:
            item.use = view.weight > 0.0
            item.weight = view.weight or 1.0
    settings.views_of, settings.views_kind = _key, seen.kind
    settings.photographs.clear()
    for told in seen.told:
        row = settings.photographs.add()
        row.name, row.view, row.registered, row.doubtful = told.name, told.view, told.registered, bool(told.doubt)
        row.picture, row.short, row.whole = told.picture, told.short, told.whole
    settings.photograph = min(settings.photograph, max(0, len(seen.told) - 1))


def _draw_thumbnails(seen: Look) -> None:
    global _previews
    if _previews is None:
        _previews = bpy.utils.previews.new()
    _previews.clear()
    for index, view in enumerate(seen.views):
        for name, pixels in (("picture", view.picture), ("mask", view.mask)):
            preview = _previews.new(f"{index} {name}")
            preview.image_size = pixels.shape[1::-1]
            preview.image_pixels_float.foreach_set(pixels.ravel())


def forget() -> None:
    """Stop a look that is going on, wait for its thread, and drop what was found and drawn."""
    global _previews, _found
    stop()
    if bpy.app.timers.is_registered(_look_again):
        bpy.app.timers.unregister(_look_again)
    for job in _stopped:
        job.join(_QUIT_PATIENCE)
    _stopped.clear()
    if _previews is not None:
        bpy.utils.previews.remove(_previews)
        _previews = None
    _found = None
