"""How good an atlas is: seams, stretch, utilisation, slivers."""

from dataclasses import dataclass

import torch

from arm_blender.graphics.connectivity import components, half_edges, manifold_pairs
from arm_blender.graphics.meshes import face_areas, signed_areas
from arm_blender.structures import UvMesh

SLIVER = 4.0
"""Texels of mean width below which a chart is a sliver: the padding around it is more than the chart."""


@dataclass(frozen=True)
class AtlasQuality:
    """Of one atlas.

    Attributes:
        charts: number of them.
        seams: length of all seams over the square root of the surface's area.
        stretch: L2 stretch (Sander et al., "Texture mapping progressive meshes", SIGGRAPH 2001), 1 is none.
        utilisation: share of the atlas that charts cover.
        slivers: share of charts that are slivers; sliver_area: of the surface that lies in them.
    """

    charts: int
    seams: float
    stretch: float
    utilisation: float
    slivers: float
    sliver_area: float


def atlas_quality(atlas: UvMesh, size: int = 1024) -> AtlasQuality:
    """Measure an atlas of `size` texels a side."""
    vertices, uvs = atlas.vertices.double(), atlas.uvs.double()
    area, flat = face_areas(vertices, atlas.faces), signed_areas(uvs, atlas.face_uvs).abs()
    pairs = manifold_pairs(atlas.faces)
    ours, theirs = half_edges(atlas.face_uvs)[pairs].unbind(dim=1)
    seam = (ours != theirs.flip(1)).any(dim=1)
    start, end = half_edges(atlas.faces)[pairs[:, 0]].unbind(dim=1)
    length = (vertices[start] - vertices[end]).norm(dim=1)[seam].sum()
    chart = components((pairs // 3)[~seam], len(atlas.faces))
    count = int(chart.max()) + 1
    corner = uvs[atlas.face_uvs]
    index = chart[:, None].expand(-1, 2)
    low = corner.new_full((count, 2), torch.inf).scatter_reduce(0, index, corner.amin(dim=1), "amin")
    high = corner.new_full((count, 2), -torch.inf).scatter_reduce(0, index, corner.amax(dim=1), "amax")
    covered = flat.new_zeros(count).index_add_(0, chart, flat)
    thin = covered * size < SLIVER * (high - low).amax(dim=1)
    surface = area.new_zeros(count).index_add_(0, chart, area)
    return AtlasQuality(
        count,
        float(length / area.sum().sqrt()),
        _stretch(atlas, area, flat),
        float(flat.sum()),
        float(thin.double().mean()),
        float(surface[thin].sum() / surface.sum()),
    )


def _stretch(atlas: UvMesh, area: torch.Tensor, flat: torch.Tensor) -> float:
    """Over the faces that have an area on both sides; the scale of the whole atlas does not count."""
    kept = (area > 1e-6 * area.mean()) & (flat > 1e-6 * flat.mean())
    solid, plane = atlas.vertices.double()[atlas.faces[kept]], atlas.uvs.double()[atlas.face_uvs[kept]]
    edges, sides = solid[:, 1:] - solid[:, :1], plane[:, 1:] - plane[:, :1]  # (F, 2, 3), (F, 2, 2)
    jacobian = torch.linalg.solve(sides, edges)  # Rows: what a step along u and along v is on the surface.
    squared = jacobian.square().sum(dim=(1, 2)) / 2.0
    scale = flat[kept].sum() / area[kept].sum()
    return float(((squared * area[kept]).sum() / area[kept].sum() * scale).sqrt())
