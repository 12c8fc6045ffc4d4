"""Samples of InstantAlbedo on the fly: a known shape under random materials and light, carried into its atlas at once.

Of each object an atlas and its visibility are kept, pictures never.
"""

import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from arm_blender.errors import ArmError
from arm_blender.structures import TriangleMesh, UvMesh

from ..rasterized import pictures as rasterized
from ..rasterized import surface as rasterized_surface
from ..rasterized.pictures import Library
from ..rasterized.surface import Surface
from ..rendering.shards import save_arrays
from .atlases import Atlas, AtlasConfig, atlas_of, random_subsets, sample_arrays, unwrapped

logger = logging.getLogger(__name__)


@dataclass
class RasterizedAtlases:
    """Random samples of some shapes.

    Attributes:
        meshes: `mesh.npz` files.
        folder: where shapes are kept.
        library: of materials and light.
        resolution: pixels a side of the pictures.
        config: of the atlases.
        without: those of the meshes that turned out to have no atlas.
    """

    meshes: list[Path]
    folder: Path
    library: Library
    resolution: int = 192
    config: AtlasConfig = field(default_factory=AtlasConfig)
    without: set[Path] = field(default_factory=set)

    def draw(self, generator: torch.Generator) -> Atlas:
        """A sample that depends on the generator alone, not on what is kept.

        Raises:
            ArmError: no mesh is left that can be unwrapped.
        """
        while len(self.without) < len(self.meshes):
            path = self.meshes[int(torch.randint(len(self.meshes), (), generator=generator))]
            shape = None if path in self.without else self.shape(path)
            if shape is None:
                # Not taken out of the list: what is drawn next must not depend on what was drawn before.
                self.without.add(path)
                continue
            mesh, surface = shape
            rig = rasterized.random_rig(surface, self.library, self.resolution, generator)
            subset = random_subsets(2, generator)[int(torch.rand((), generator=generator) < 0.67)]
            # Two pixels of the z-buffer for each of the pictures', as at inference.
            return atlas_of(sample_arrays(mesh, rig, self.config.size, subset[None], 2 * self.resolution), 0)
        raise ArmError(f"{self.folder}: no object that can be unwrapped; give other --shards")

    def shape(self, path: Path) -> tuple[UvMesh, Surface] | None:
        """A mesh with its atlas and what it needs to be lit, kept or made; None where it cannot be unwrapped."""
        kept = self.folder / f"{path.parent.name}.{self.config.size}.atlas.npz"
        light = kept.with_name(f"{path.parent.name}.{self.config.size}.surface.npz")
        if kept.exists() and light.exists():
            return read_atlas(kept), rasterized_surface.load(light)
        mesh = unwrapped(path, self.config)
        if mesh is None:
            return None
        logger.info("prepared %s to be rasterised", path.parent.name)
        surface = rasterized_surface.surface_of(TriangleMesh(mesh.vertices, mesh.faces))
        rasterized_surface.save(light, surface)
        save_atlas(kept, mesh)
        return mesh, surface


def save_atlas(path: Path, mesh: UvMesh) -> None:
    """Keep a mesh with its atlas.

    Raises:
        OutputError: the file cannot be written.
    """
    arrays = {name: getattr(mesh, name).numpy() for name in ("vertices", "faces", "uvs", "face_uvs")}
    save_arrays(path, arrays | {"charts": np.array(mesh.charts)})


def read_atlas(path: Path) -> UvMesh:
    """What `save_atlas` kept."""
    with np.load(path) as file:
        vertices, faces, uvs, face_uvs = (
            torch.from_numpy(file[name]) for name in ("vertices", "faces", "uvs", "face_uvs")
        )
        return UvMesh(vertices, faces, uvs, face_uvs, int(file["charts"]))
