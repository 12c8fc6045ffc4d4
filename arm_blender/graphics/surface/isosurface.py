"""Iso-surfaces of a density over the box [-1, 1]^3: marching cubes in torch, evaluated only where the surface is.

The density is asked on a grid of samples. A coarse pass finds the blocks that the surface can cross; those are sampled
finely, and wherever the surface leaves a sampled block the next one is added, until it is closed. Every vertex lies on
one edge of the grid, so that its position is a differentiable function of two densities (`vertices_from_densities`).
"""

import logging
from dataclasses import dataclass

import torch
from torch import Tensor

from ...errors import EmptyMeshError
from ...progress import Progress, silent
from ...structures import TriangleMesh
from ..ragged import enumerate_items
from .block_search import sample_blocks
from .marching_tables import CORNERS, EDGES, triangle_table
from .sample_grid import BlockSamples, Density, IsosurfaceConfig

logger = logging.getLogger(__name__)

END_MARGIN = 1e-3
"""Vertices keep this share of a grid edge away from its ends: where samples equal the iso-value exactly, all edges of a
sample would meet in it and leave faces without area."""


@dataclass(frozen=True)
class CrossedEdges:
    """The surface as edges of the grid: one vertex on each.

    Attributes:
        a: (N, 3) world, the lower end. b: (N, 3) world, the upper end; equal to `a` on the box's boundary.
        density_a, density_b: (N,) float32 as the density returned them.
        faces: (F, 3) int64, indices of edges.
    """

    a: Tensor
    b: Tensor
    density_a: Tensor
    density_b: Tensor
    faces: Tensor


def extract(
    density: Density, config: IsosurfaceConfig, progress: Progress = silent, device: torch.device | str = "cpu"
) -> TriangleMesh:
    """The surface that bounds {density > iso}, closed at the box; outward counter-clockwise, welded.

    Args:
        density: (P, 3) world float32 on `device` -> (P,). +inf is inside; -inf and NaN are outside.
        config: resolution and iso-value.
        progress: called at every chunk of evaluations.
        device: of the points that the density is asked for, and of the mesh.
    Raises:
        EmptyMeshError: nothing, or nothing that was found, lies inside.
        ValueError: the density returns another shape than (P,).
    """
    edges = crossed_edges(density, config, progress, device)
    vertices = vertices_from_densities(edges.a, edges.b, edges.density_a, edges.density_b, config.iso)
    return TriangleMesh(vertices, edges.faces)


def vertices_from_densities(a: Tensor, b: Tensor, density_a: Tensor, density_b: Tensor, iso: float) -> Tensor:
    """(N, 3) points where the density, linear between `a` and `b`, equals `iso`; differentiable in all tensors.

    Args:
        a, b: (N, 3) end points.
        density_a, density_b: (N,). Where either is not finite, or both are equal, the result is the middle.
    """
    difference = density_b - density_a
    regular = torch.isfinite(density_a) & torch.isfinite(density_b) & torch.isfinite(difference) & (difference != 0)
    # Both branches of `where` get a gradient: the unused one must stay finite.
    numerator = torch.where(regular, iso - density_a, 0.5)
    share = numerator / torch.where(regular, difference, 1.0)
    return torch.lerp(a, b, share.clamp(END_MARGIN, 1.0 - END_MARGIN)[:, None])


def crossed_edges(
    density: Density, config: IsosurfaceConfig, progress: Progress = silent, device: torch.device | str = "cpu"
) -> CrossedEdges:
    """The edges of the grid that the surface crosses and the faces between them; arguments and errors of `extract`.

    Nothing has a gradient. For training, ask the density again at `a` and `b` and call `vertices_from_densities`.
    """
    with torch.no_grad():
        samples = sample_blocks(density, config, progress, torch.device(device))
        progress(1.0, "Marching cubes")
        keys, faces = _triangles(samples)
        if not len(faces):
            raise EmptyMeshError(_nothing_found(samples, config))
        lower, upper, faces = _weld(samples, keys, faces)
        logger.debug("%d of %d samples evaluated", samples.evaluated, config.resolution**3)
        return CrossedEdges(
            samples.points(lower), samples.points(upper), samples.values[lower], samples.values[upper], faces
        )


def _nothing_found(samples: BlockSamples, config: IsosurfaceConfig) -> str:
    highest = samples.highest
    found = f"its highest value there is {highest:.4g}" if highest is not None else "it is nowhere a number"
    return (
        f"the density has no surface at {config.iso:g} inside the box [-1, 1]^3 ({found}); "
        "check that the views show the object on a transparent background and that their cameras look at the box, "
        "or evaluate densely at a higher grid resolution (--dense, --grid)"
    )


def _triangles(samples: BlockSamples) -> tuple[Tensor, Tensor]:
    """Keys of the crossed edges of every triangle's corners (T * 3,), and (T, 3) indices into them.

    A key is 4 * (lower sample) + axis. Beyond the box's boundary nothing is sampled: an edge that leaves it has the
    key 4 * (inside sample) + 3, whichever way it goes, and its vertex is this sample.
    """
    device = samples.values.device
    table, count = (t.to(device) for t in triangle_table())
    stride = torch.tensor([1, samples.side, samples.side**2], device=device)  # Of x, y, z in the flat array.
    corner_offset = (torch.tensor(CORNERS, device=device) * stride).sum(dim=1)

    first, case = samples.crossed_cells()  # (C,), (C,)
    cell, number = enumerate_items(count[case])
    edge = table[case[cell], number].flatten()  # (T * 3,)

    corner, axis = torch.tensor(EDGES, device=device).unbind(dim=1)
    lower = first[cell].repeat_interleave(3) + corner_offset[corner][edge]
    axis = axis[edge]
    upper = lower + stride[axis]
    keys = 4 * lower + axis
    keys = torch.where(samples.in_box[lower], keys, 4 * upper + 3)
    keys = torch.where(samples.in_box[upper], keys, 4 * lower + 3)
    return keys, torch.arange(len(keys), device=device).reshape(-1, 3)


def _weld(samples: BlockSamples, keys: Tensor, faces: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """One vertex for each key: flat samples (N,) of the lower and of the upper ends, and (F, 3) faces.

    Along the box's edges, the vertices of one sample fall together; the faces between them are dropped.
    """
    distinct, index = torch.unique(keys, return_inverse=True)
    faces = index[faces]
    whole = (faces != faces.roll(1, dims=1)).all(dim=1)
    lower, axis = distinct // 4, distinct % 4
    stride = torch.tensor([1, samples.side, samples.side**2, 0], device=keys.device)
    used = torch.zeros(len(distinct), dtype=torch.bool, device=keys.device)
    used[faces[whole].flatten()] = True
    renumbered = torch.cumsum(used, dim=0) - 1
    return lower[used], (lower + stride[axis])[used], renumbered[faces[whole]]
