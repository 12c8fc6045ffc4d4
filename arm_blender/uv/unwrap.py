"""A UV atlas for a mesh: by xatlas within a time limit, by projection otherwise."""

import logging
import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ..errors import UnwrapError
from ..graphics.meshes import face_areas, signed_areas
from ..progress import Progress, silent
from ..structures import TriangleMesh, UvMesh
from .charts import pack, projection_charts

logger = logging.getLogger(__name__)

Method = Literal["xatlas", "projection"]

WORKER = Path(__file__).with_name("xatlas_worker.py")
POLL_SECONDS = 0.05


@dataclass(frozen=True)
class UnwrapConfig:
    """How the surface is cut and packed."""

    texture_size: int = 1024
    """Texels a side of the square atlas. Charts are spaced for this size; at a smaller one they come too near."""
    padding: int = 3
    """Texels between charts. Fewer bleed at coarser mip levels; more waste the atlas where charts are many."""
    time_limit: float = 60.0
    """Seconds that xatlas may take before projection replaces it; 0 projects at once."""
    max_cost: float = 2.0
    """Of growing a chart: higher makes larger, more stretched charts, and takes longer."""
    max_chart_share: float = 0.1
    """Largest chart, as a share of the surface; 0 sets no limit. xatlas flattens several charts much faster than a few
    large ones: at 20k faces 0.1 takes half the time of no limit and has as many seams; 0.03 takes a third and has 1.1
    times the seams."""

    def __post_init__(self) -> None:
        if self.texture_size < 16 or self.padding < 0:
            raise ValueError(f"texture_size {self.texture_size} >= 16, padding {self.padding} >= 0")


def unwrap(mesh: TriangleMesh, config: UnwrapConfig, progress: Progress = silent) -> tuple[UvMesh, Method]:
    """The mesh with an atlas in which no two faces overlap, and how it was made.

    The geometry is unchanged and stays welded; faces without an area have a point or a line for UVs.

    Args:
        mesh: clean (`decimate.clean`) and of some ten thousand faces, or xatlas may run into the time limit.
        config: size, padding, limit.
        progress: called every 0.05 s while xatlas works; what it raises stops xatlas at once.
    Raises:
        UnwrapError: the mesh has no faces, or vertices that are not finite.
    """
    if not len(mesh.faces):
        raise UnwrapError("the mesh has no faces to unwrap; check the density, or the mesh file")
    if not bool(mesh.vertices[mesh.faces].isfinite().all()):
        raise UnwrapError("the mesh has vertices that are not finite; clean it first")
    atlas = _by_xatlas(mesh, config, progress) if config.time_limit > 0 else None
    if atlas is not None:
        return atlas, "xatlas"
    progress(0.9, "Unwrapping by projection")
    return _by_projection(mesh, config), "projection"


def _by_projection(mesh: TriangleMesh, config: UnwrapConfig) -> UvMesh:
    chart, plane = projection_charts(mesh.vertices, mesh.faces)
    corner_uvs = pack(chart, plane, config.texture_size, config.padding)
    charts = int(chart.max()) + 1
    # A vertex has one UV in each chart that meets in it.
    key = mesh.faces * charts + chart[:, None]
    distinct, face_uvs = torch.unique(key, return_inverse=True)
    uvs = corner_uvs.new_zeros(len(distinct), 2)
    uvs[face_uvs.flatten()] = corner_uvs.reshape(-1, 2)
    return UvMesh(mesh.vertices, mesh.faces, uvs, face_uvs, charts)


def _by_xatlas(mesh: TriangleMesh, config: UnwrapConfig, progress: Progress) -> UvMesh | None:
    """The atlas of xatlas; None where it took too long or failed. Whatever `progress` raises passes through."""
    with tempfile.TemporaryDirectory(prefix="arm-unwrap-") as folder:
        source, target, log = (Path(folder, name) for name in ("mesh.npz", "atlas.npz", "log.txt"))
        area = face_areas(mesh.vertices, mesh.faces).sum()
        np.savez(
            source,
            vertices=mesh.vertices.detach().cpu().numpy().astype(np.float32),
            faces=mesh.faces.cpu().numpy().astype(np.uint32),
            texture_size=config.texture_size,
            padding=config.padding,
            max_cost=config.max_cost,
            max_chart_area=config.max_chart_share * float(area),
        )
        if not _run_worker(source, target, log, config.time_limit, _expected_seconds(mesh), progress):
            return None
        with np.load(target) as atlas:
            return _uv_mesh(mesh, {name: torch.from_numpy(value) for name, value in atlas.items()})


def _expected_seconds(mesh: TriangleMesh) -> float:
    """Only for the progress bar: about what xatlas takes for the faces."""
    return 0.3 + len(mesh.faces) / 1e4


def _uv_mesh(mesh: TriangleMesh, atlas: dict[str, Tensor]) -> UvMesh | None:
    """xatlas's answer on the mesh's own vertices; None where it does not fit the mesh."""
    device = mesh.vertices.device
    face_uvs = atlas["face_uvs"].long()
    if not torch.equal(atlas["original"].long()[face_uvs], mesh.faces.cpu()) or not bool(atlas["uvs"].isfinite().all()):
        logger.warning("xatlas returned another mesh than it was given; unwrapping by projection")
        return None
    # UVs come as shares of a width and of a height that differ: back to squares.
    uvs = (atlas["uvs"] * atlas["size"] / atlas["size"].max()).float().clamp(0.0, 1.0)
    face_uvs = _shrink_dropped(mesh.faces.cpu(), uvs, face_uvs)
    return UvMesh(mesh.vertices, mesh.faces, uvs.to(device), face_uvs.to(device), int(atlas["charts"]))


def _shrink_dropped(faces: Tensor, uvs: Tensor, face_uvs: Tensor) -> Tensor:
    """(F, 3) `face_uvs` in which faces that xatlas left out, all in one place, lie on a corner of a face beside."""
    flat = signed_areas(uvs, face_uvs) == 0.0
    if not flat.any():
        return face_uvs
    # Any UV that a vertex has in a sound face; -1 where it has none.
    beside = face_uvs.new_full((int(faces.max()) + 1,), -1)
    beside[faces[~flat].flatten()] = face_uvs[~flat].flatten()
    place = beside[faces[flat]].amax(dim=1, keepdim=True).expand(-1, 3)
    face_uvs = face_uvs.clone()
    face_uvs[flat] = torch.where(place >= 0, place, face_uvs[flat])
    return face_uvs


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
            logger.warning("xatlas cannot be started (%s); unwrapping by projection", error)
            return False
        try:
            while process.poll() is None:
                elapsed = time.monotonic() - started
                if elapsed > limit:
                    logger.warning("xatlas took longer than %.3g s; unwrapping by projection", limit)
                    return False
                progress(0.9 * (1.0 - math.exp(-elapsed / expected)), "Unwrapping")
                _wait(process, min(POLL_SECONDS, max(limit - elapsed, 0.0)))
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
    if process.returncode != 0 or not target.exists():
        last = log.read_text(errors="replace").strip().splitlines()[-1:] or [f"status {process.returncode}"]
        logger.warning("xatlas failed (%s); unwrapping by projection", last[0])
        return False
    return True


def _wait(process: subprocess.Popen, seconds: float) -> None:
    """Sleep until the process ends, but no longer than `seconds`."""
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        return
