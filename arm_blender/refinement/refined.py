"""The refinement as a stage of a run: whether there is one, and what the report says of it."""

import time

from ..progress import Progress, silent
from ..report import Report
from ..structures import TriangleMesh, ViewSet
from .refine import refine

FEWEST_VIEWS = 3
"""Fewer say too little: one picture's outline and colours are met by any depth."""

MOST_VERTICES = 120_000
"""Of a mesh; a finer one would take minutes, and no picture is as fine."""


def refined(
    mesh: TriangleMesh, views: ViewSet, rounds: int, report: Report, progress: Progress = silent
) -> TriangleMesh:
    """`mesh` moved to meet normalised `views` in so many rounds, or as it is where that makes nothing better."""
    if rounds == 0:
        return mesh
    if len(views.cameras) < FEWEST_VIEWS:
        report.leave_out("refinement of the shape", f"it takes {FEWEST_VIEWS} views to say where a surface lies")
        return mesh
    if len(mesh.vertices) > MOST_VERTICES:
        report.leave_out("refinement of the shape", f"the mesh has more than {MOST_VERTICES:,} vertices; lower --grid")
        return mesh
    start = time.perf_counter()
    found = refine(mesh, views, rounds, progress=progress)
    report.refinement = {
        "rounds": rounds,
        "seconds": round(time.perf_counter() - start, 3),
        "outline_error_before": round(found.before, 3),
        "outline_error_after": round(found.after, 3),
        "trust": [round(share, 2) for share in found.trust],
        "symmetry": False,
    }
    if not found.better:
        report.leave_out(
            "refinement of the shape", "the outlines of its pictures contradict each other, or it met them already"
        )
    return found.mesh
