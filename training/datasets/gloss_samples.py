"""Samples that supervise roughness and metallic on a shape that GeoRM made, by what the views show of both."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from arm_blender import networks
from arm_blender.config import PRESETS, QUALITIES
from arm_blender.errors import EmptyMeshError
from arm_blender.graphics.surface.fairing import fair
from arm_blender.graphics.surface.isosurface import extract
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig
from arm_blender.models.network_views import PictureConfig
from arm_blender.refinement.refine import refine
from arm_blender.structures import TriangleMesh
from arm_blender.uv.decimate import clean, decimate
from arm_blender.weight_files import checkpoints

from ..rendering import shards
from . import view_samples
from .point_samples import input_views
from .view_samples import ViewSample

logger = logging.getLogger(__name__)

POINTS_AT_ONCE = 2**16
"""Bounds the memory of the density's evaluation."""


@dataclass(frozen=True)
class GlossSample(ViewSample):
    """A rig of an object; `vertices` are those of GeoRM's shape.

    Attributes:
        faces: (F, 3) int64; none where GeoRM found no surface.
        gloss: (V, 2, S, S) true roughness and metallic in [0, 1].
    """

    faces: Tensor
    gloss: Tensor


class Shapes:
    """GeoRM as it is, and the shapes that it makes of the input views; the same mesh as in the program.

    Args:
        weights: of a GeoRM, of any preset.
        grid: samples of the density along a side of the box.
        device: where it runs.
        folder: keeps the shapes, by object, rig, weights and grid; None makes each anew whenever it is asked for.
    """

    def __init__(self, weights: Path, grid: int, device: torch.device, folder: Path | None = None) -> None:
        self.model: Any = networks.read("georm", weights).requires_grad_(False).eval().to(device)
        self.grid, self.device, self.folder = grid, device, folder
        self._mark = mark(weights, grid)

    def load(self, path: Path, network: PictureConfig) -> GlossSample:
        """The sample of one `rig_<k>.npz`, for a GlossyRM of `network`."""
        sample = view_samples.load(path, network)
        mesh = self.mesh(path)
        maps = shards.arrays(path, "roughness", "metallic")
        gloss = torch.from_numpy(np.stack([maps["roughness"], maps["metallic"]], axis=1)).float() / 255.0
        return GlossSample(sample.inputs, sample.c2w, sample.K, sample.truth, mesh.vertices, mesh.faces, gloss)

    def mesh(self, path: Path) -> TriangleMesh:
        """What GeoRM makes of a rig, from the folder where it is there; without faces where it finds no surface."""
        return self._kept(path, self._mark, self._made)

    def refined(self, path: Path, faces: int) -> TriangleMesh:
        """What the program makes of that: cleaned, faired, moved to meet the input views, decimated to `faces`."""

        def made(path: Path) -> TriangleMesh:
            mesh = self.mesh(path)
            if not len(mesh.faces):
                return mesh
            views = input_views(shards.arrays(path, "rgba", "c2w", "K"), path.parent.name)
            smooth = fair(clean(mesh), PRESETS["small"].fairing)
            return decimate(refine(smooth, views, QUALITIES["balanced"].refinement).mesh, faces)

        return self._kept(path, f"{self._mark}.{faces}", made)

    def _kept(self, path: Path, mark: str, make: Callable[[Path], TriangleMesh]) -> TriangleMesh:
        """The shape of a rig that is kept under `mark`, made where it is not; made each time without a folder."""
        if self.folder is None:
            return make(path)
        kept = self.folder / kept_as(path, mark)
        if not kept.exists():
            mesh = make(path)
            shards.save_arrays(kept, {"vertices": mesh.vertices.numpy(), "faces": mesh.faces.numpy().astype(np.int32)})
        return shards.read_mesh(kept)

    @torch.no_grad()
    def _made(self, path: Path) -> TriangleMesh:
        inputs = view_samples.on_device(view_samples.load(path, self.model.config).inputs, self.device)
        density = self.model.filled_logit(self.model.encode(inputs), POINTS_AT_ONCE)
        try:
            mesh = extract(density, IsosurfaceConfig(self.grid, iso=0.0, chunk=POINTS_AT_ONCE), device=self.device)
        except EmptyMeshError:
            logger.info("%s: GeoRM finds no surface; nothing is learnt from it", path)
            return TriangleMesh(torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.int64))
        return TriangleMesh(mesh.vertices.cpu(), mesh.faces.cpu())


def mark(weights: Path, grid: int) -> str:
    """Of the shapes that GeoRM of these weights has on a grid."""
    return f"{checkpoints.sha256(weights)[:12]}.{grid}"


def kept_as(path: Path, mark: str) -> str:
    """Name of the file that keeps the shape of one `rig_<k>.npz`."""
    return f"{path.parent.name}.{path.stem}.{mark}.npz"
