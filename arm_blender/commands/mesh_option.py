"""--mesh: a user's own mesh, and which way up it is."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..report import Report
    from ..structures import TriangleMesh, UvMesh, ViewSet

LEAST_FIT = 0.7
"""Intersection over union of a given mesh's outlines with the masks, below which it is doubtful."""


def up(text: str) -> str:
    """The value of --mesh-up."""
    if text not in ("auto", "y", "z"):
        raise argparse.ArgumentTypeError(f"{text!r}: give auto, y or z")
    return text


def own_mesh(path: Path, axis: str, report: Report, views: ViewSet) -> TriangleMesh | UvMesh:
    """The mesh in a file, upright in the frame of the views.

    Args:
        path: of the file.
        axis: that is up in it, "y" or "z"; "auto" takes that with which its outlines fit. A glTF says so itself.
        report: is told which axis it was and why, what of the mesh is not used, and where it does not fit.
        views: that show it.
    Raises:
        EmptyMeshError: as `read_mesh`.
    """
    from ..uv.mesh_file import Y_UP, read_mesh
    from ..views.mesh_fit import outline_fit, up_axis, z_up

    mesh = read_mesh(path, report.leave_out)
    found = "z" if path.suffix.lower() in Y_UP else axis
    if found == "auto":
        found, fits = up_axis(mesh, views)
        other = "y" if found == "z" else "z"
        why = f"its outlines fit the masks to {fits[other]:.2f}, with {found.upper()} up to {fits[found]:.2f}"
        report.leave_out(f"{other.upper()} up in {path.name}", f"{why}; --mesh-up overrules it")
    if found == "y":
        mesh = mesh.moved(z_up)
    fit = outline_fit(mesh, views)
    if fit < LEAST_FIT:
        line = f"the outlines of {path.name} fit the masks to {fit:.2f} only"
        report.doubt(f"{line}; bring it to where the cameras look, or check its axes")
    return mesh
