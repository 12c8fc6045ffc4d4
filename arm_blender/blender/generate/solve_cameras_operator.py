"""Cameras of photographs, at the press of a button: to look at before anything is made of them."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import bpy

from ...errors import ArmError
from ...progress import Progress
from ...report import Report
from ..input import request
from ..input.generation_request import GenerationRequest, solving_options, view_options, views_folder
from .operators import Run


class Solved(NamedTuple):
    """What solving gives: the folder of the views, and what is to be said of it."""

    folder: Path
    report: Report


def solve(wanted: GenerationRequest, folder: Path, progress: Progress) -> Solved:
    """Make the views of photographs, with their cameras. On a worker thread: no bpy here.

    Raises:
        ArmError: they cannot be solved; `Cancelled` from `progress`.
    """
    progress(0.0, "starting")
    from ...photographs.intake import make_views

    assert isinstance(wanted.views, Path)  # As `_wanted` has it.
    report = Report(wanted.preset, wanted.device, wanted.seed)
    return Solved(
        make_views(wanted.views, folder, view_options(wanted), solving_options(wanted), report, progress), report
    )


class ARM_OT_solve_cameras(Run, bpy.types.Operator):
    """Find where the photographs were taken from: their cameras come into the scene, their views into a folder beside
    them; look at both, then generate"""

    bl_idname = "arm.solve_cameras"
    bl_label = "Solve Cameras"

    def _wanted(self, context: bpy.types.Context) -> GenerationRequest:
        wanted = request.from_panel(context)
        if not isinstance(wanted.views, Path) or not wanted.views.exists():
            raise ArmError("Choose a folder of photographs, or a video, first")
        self._folder = views_folder(wanted.views)
        return wanted

    def _networks(self, wanted: GenerationRequest) -> str:
        return "cameras"

    def _work(self, wanted: GenerationRequest) -> Callable[[Progress], Solved]:
        return partial(solve, wanted, self._folder)

    def _deliver(self, context: bpy.types.Context, made: Solved) -> str:
        from ..input.scene_cameras import add_cameras, add_ground, placed_views

        views, ground = placed_views(made.folder)
        cameras = add_cameras(context.scene, f"{made.folder.stem} cameras", views)
        if ground is not None:
            add_ground(cameras[0].users_collection[0], ground)
        context.scene.arm.views_path = str(made.folder)  # Which has them read and shown.
        for why in made.report.all_doubts:
            self.report({"WARNING"}, f"Doubtful: {why}")
        return f"{made.folder.name}: {len(cameras)} views; look at them, then press Generate"


register, unregister = bpy.utils.register_classes_factory((ARM_OT_solve_cameras,))
