"""A UV atlas for a mesh: our charts, packed by xatlas within a time limit, and on shelves otherwise.

xatlas can find charts as well; it takes ten times as long for charts of the same seams and more stretch.
"""

import logging
import math
import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ..errors import UnwrapError
from ..graphics.meshes import signed_areas
from ..machine.memory import limit_child
from ..progress import Progress, silent
from ..structures import TriangleMesh, UvMesh
from . import shelves
from .flatten import flat_charts

logger = logging.getLogger(__name__)

Packing = Literal["xatlas", "shelves"]

WORKER = Path(__file__).with_name("xatlas_worker.py")
POLL_SECONDS = 0.05
MEMORY = 8 * 2**30
"""Bytes that xatlas may take: several times what a million faces need."""

FLATTENING = 0.4  # Of the progress bar.

RELAXING, PACKING = 0.4, 0.85
"""Of the time limit: when charts are left as stretched as they are, and when xatlas is stopped. What follows takes its
time as well: laying down again what failed, and the shelves."""


@dataclass(frozen=True)
class UnwrapConfig:
    """How the surface is cut and packed."""

    texture_size: int = 1024
    """Texels a side of the square atlas. Charts are spaced for this size; at a smaller one they come too near."""
    padding: int = 3
    """Texels between charts. Fewer bleed at coarser mip levels; more waste the atlas where charts are many."""
    time_limit: float = 60.0
    """Seconds for all of it: xatlas is stopped in time, and shelves replace it; 0 leaves xatlas out. Finding charts
    takes its own few seconds for half a million faces, however short the limit."""

    def __post_init__(self) -> None:
        if self.texture_size < 16 or self.padding < 0:
            raise ValueError(f"texture_size {self.texture_size} >= 16, padding {self.padding} >= 0")


def unwrap(mesh: TriangleMesh, config: UnwrapConfig, progress: Progress = silent) -> tuple[UvMesh, Packing]:
    """The mesh with an atlas in which no two faces overlap, and how its charts were packed.

    The geometry is unchanged and stays welded; faces without an area have a point or a line for UVs.

    Args:
        mesh: clean (`decimate.clean`).
        config: size, padding, limit.
        progress: called every 0.05 s while xatlas works; what it raises stops xatlas at once.
    Raises:
        UnwrapError: the mesh has no faces, or vertices that are not finite.
    """
    if not len(mesh.faces):
        raise UnwrapError("the mesh has no faces to unwrap; check the density, or the mesh file")
    if not bool(mesh.vertices[mesh.faces].isfinite().all()):
        raise UnwrapError("the mesh has vertices that are not finite; clean it first")
    started = time.monotonic()
    vertices, faces = mesh.vertices.detach().float().cpu(), mesh.faces.cpu()
    deadline = started + (RELAXING * config.time_limit or math.inf)
    chart, plane = flat_charts(vertices, faces, deadline, lambda done, message: progress(FLATTENING * done, message))
    charts = int(chart.max()) + 1
    # A vertex has one place in each chart that meets in it.
    corner, face_uvs = torch.unique(faces * charts + chart[:, None], return_inverse=True)
    limit = PACKING * config.time_limit - (time.monotonic() - started)
    uvs = None
    if limit > 0:
        try:
            uvs = _by_xatlas(plane, corner % charts, face_uvs, config, limit, progress)
        except OSError as error:  # The folder for temporary files is full, read-only or missing.
            logger.warning("xatlas got no temporary files (%s); packing on shelves", error)
    packing: Packing = "xatlas"
    if uvs is None:
        progress(0.9, "Packing charts on shelves")
        packing, uvs = "shelves", plane.new_zeros(len(corner), 2)
        uvs[face_uvs.flatten()] = shelves.pack(chart, plane, config.texture_size, config.padding).reshape(-1, 2)
    device = mesh.vertices.device
    return UvMesh(mesh.vertices, mesh.faces, uvs.to(device), face_uvs.to(device), charts), packing


def _by_xatlas(
    plane: Tensor, chart: Tensor, face_uvs: Tensor, config: UnwrapConfig, limit: float, progress: Progress
) -> Tensor | None:
    """(M, 2) UVs of the M corners of charts, packed by xatlas; None where it took too long or failed.

    Args:
        plane: (F, 3, 2) corners in the plane of their chart. chart: (M,) of each corner. face_uvs: (F, 3).
    """
    places = plane.new_zeros(len(chart), 2)
    places[face_uvs.flatten()] = plane.reshape(-1, 2)
    with tempfile.TemporaryDirectory(prefix="arm-unwrap-") as folder:
        source, target, log = (Path(folder, name) for name in ("charts.npz", "atlas.npz", "log.txt"))
        request = BytesIO()  # A zip file that cannot be ended, the disk being full, complains long after.
        np.savez(
            request,
            places=places.double().numpy(),
            chart=chart.numpy(),
            faces=face_uvs.numpy().astype(np.uint32),
            area=float(signed_areas(places, face_uvs).sum()),
            texture_size=config.texture_size,
            padding=config.padding,
        )
        source.write_bytes(request.getbuffer())
        expected = 0.3 + len(face_uvs) / 1e5  # Only for the progress bar: about the seconds that xatlas takes.
        if not _run_worker(source, target, log, limit, expected, progress):
            return None
        with np.load(target) as atlas:
            uvs = torch.from_numpy(atlas["uvs"]).float()
    if not bool(uvs.isfinite().all()):
        logger.warning("xatlas returned UVs that are not finite; packing on shelves")
        return None
    return uvs.clamp(0.0, 1.0)


def _run_worker(source: Path, target: Path, log: Path, limit: float, expected: float, progress: Progress) -> bool:
    """Whether xatlas wrote `target` in `limit` seconds. The process is gone when this returns or raises."""
    search_path = os.pathsep.join(str(path) for path in sys.path)
    command = [sys.executable, "-I", str(WORKER), str(source), str(target), search_path]
    started = time.monotonic()
    with log.open("w") as output:
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # No console window on Windows.
            )
        except OSError as error:
            logger.warning("xatlas cannot be started (%s); packing on shelves", error)
            return False
        limit_child(process.pid, MEMORY)
        try:
            while process.poll() is None:
                elapsed = time.monotonic() - started
                if elapsed > limit:
                    logger.warning("xatlas took longer than %.3g s; packing on shelves", limit)
                    return False
                progress(FLATTENING + (0.9 - FLATTENING) * (1.0 - math.exp(-elapsed / expected)), "Packing charts")
                with suppress(subprocess.TimeoutExpired):
                    process.wait(min(POLL_SECONDS, max(limit - elapsed, 0.0)))
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
    if process.returncode != 0 or not target.exists():
        last = log.read_text(errors="replace").strip().splitlines()[-1:] or [f"status {process.returncode}"]
        logger.warning("xatlas failed (%s); packing on shelves", last[0])
        return False
    return True
