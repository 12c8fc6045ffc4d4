"""Take the waves off a surface that are shorter than what the network can know, and give back what that takes.

An iso-surface of a learned density carries the steps of its grids. They are a small error of position and a large one
of the normals, which is what a light shows.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from ...structures import TriangleMesh
from ..connectivity import half_edges, neighbours_of_vertices
from ..meshes import vertex_normals

_SHARPNESS = 10.0
"""Terms of the filter times the angle of its limit: more of them cut more sharply. Hamming's window needs about 10."""


@dataclass(frozen=True)
class FairingConfig:
    """What a surface is freed of."""

    wavelength: float = 0.0
    """Waves shorter than this go, world units; 0 leaves the surface as it is."""
    swell: float = 0.0
    """Moved outwards by this, world units."""


def fair(mesh: TriangleMesh, config: FairingConfig) -> TriangleMesh:
    """The surface without its short waves, and swollen; the faces stay, and so does its device.

    Args:
        mesh: of an iso-surface: its edges are of about one length.
    """
    device, vertices, faces = mesh.vertices.device, mesh.vertices.cpu(), mesh.faces.cpu()
    if config.wavelength > 0.0:
        vertices = low_pass(vertices, faces, config.wavelength)
    if config.swell:
        vertices = vertices + config.swell * vertex_normals(vertices, faces)
    return TriangleMesh(vertices.to(device), mesh.faces)


def low_pass(vertices: Tensor, faces: Tensor, wavelength: float) -> Tensor:
    """Vertices of a surface whose waves shorter than `wavelength` are gone; its centre stays.

    A Chebyshev polynomial of the graph's Laplacian with a Hamming window (Taubin, Zhang and Golub 1996): a dozen or two
    averages over neighbours, where repeated smoothing would need hundreds and shrink the surface.

    Args:
        vertices: (N, 3).
        faces: (F, 3); every vertex is used.
        wavelength: world units. Waves shorter than two edges are not told apart.
    Returns:
        (N, 3).
    """
    edges = half_edges(faces)
    length = float((vertices[edges[:, 0]] - vertices[edges[:, 1]]).norm(dim=1).mean())
    # A wave is an eigenvector of the average over neighbours; six of them on a plane make it 1 - (pi h / wavelength)^2.
    limit = math.acos(max(-1.0, 1.0 - (math.pi * length / wavelength) ** 2))
    factors = _chebyshev_low_pass(limit, math.ceil(_SHARPNESS / limit))
    neighbours, begin = neighbours_of_vertices(faces, len(vertices))

    def average(x: Tensor) -> Tensor:
        return functional.embedding_bag(neighbours, x, begin, mode="mean")

    center = vertices.mean(dim=0)
    older, newer = vertices - center, average(vertices - center)
    result = factors[0] * older + factors[1] * newer
    for factor in factors[2:]:
        older, newer = newer, 2.0 * average(newer) - older
        result = result + factor * newer
    return result + center


def _chebyshev_low_pass(limit: float, order: int) -> list[float]:
    """Factors of the Chebyshev polynomials 0 to `order` whose sum is 1 for angles below `limit` and 0 beyond it."""
    n = torch.arange(1, order + 1, dtype=torch.float64)
    window = 0.54 + 0.46 * torch.cos(n * math.pi / (order + 1))
    factors = torch.cat([n.new_tensor([limit / math.pi]), 2.0 * torch.sin(n * limit) / (n * math.pi) * window])
    return (factors / factors.sum()).tolist()  # What has no waves at all stays exactly where it is.
