"""One run, from wherever its views come to its asset: what the command line and Blender's panel have in common.

Importing this module imports nothing heavy: that is the first part of a run, and its seconds are counted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from .progress import Progress, part
from .report import Report

if TYPE_CHECKING:
    from .config import Settings
    from .structures import RelightableAsset, TriangleMesh, UvMesh, ViewSet

LOADING_SHARE = 0.05
"""Of the progress, where views are only read; the networks take the rest."""


def begin(preset: str, device: str, seed: int, progress: Progress) -> Report:
    """The report of a run, with the seconds that importing the pipeline took; a later run finds that done."""
    report = Report(preset, device, seed)
    progress(0.0, "starting")
    with report.stage("start"):
        from . import pipeline, views  # noqa: F401
    return report


def make(
    settings: Settings,
    read_views: Callable[[Progress, Report], ViewSet],
    read_mesh: Callable[[ViewSet], TriangleMesh | UvMesh] | None,
    progress: Progress,
    report: Report,
    loading_share: float = LOADING_SHARE,
) -> RelightableAsset:
    """Read the views, and the mesh where one is given, and run the pipeline.

    Args:
        settings: of the pipeline.
        read_views: is called with its own progress and with the report, for what is not used.
        read_mesh: gives a user's mesh in the frame of the views' cameras; None has the shape reconstructed.
        progress: of all of it.
        report: as `begin` made it.
        loading_share: of the progress, what reading takes.
    Returns:
        The asset in the cameras' frame; `report` is complete.
    Raises:
        ArmError: as the stages; `Cancelled` from `progress`.
    """
    from . import pipeline
    from .views.doubts import doubts

    with report.stage("views"):
        views = read_views(part(progress, 0.0, loading_share), report)
        report.doubt(*doubts(views))
        mesh = None if read_mesh is None else read_mesh(views)
    asset, _ = pipeline.generate(views, settings, part(progress, loading_share, 1.0), report, mesh)
    return asset
