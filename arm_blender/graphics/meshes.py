"""Areas, normals and random points of triangle meshes, in plain torch."""

import torch
from torch import Tensor

MIN_LENGTH = 1e-20  # Below it a vector has no direction; float32 keeps it apart from 0.


def face_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """(F, 3) unit normals, outward where the winding is counter-clockwise; 0 for a face without area.

    Args:
        vertices: (N, 3) world.
        faces: (F, 3) int64.
    """
    return _unit(_area_vectors(vertices, faces))


def face_areas(vertices: Tensor, faces: Tensor) -> Tensor:
    """(F,) areas, square world units."""
    return 0.5 * _area_vectors(vertices, faces).norm(dim=1)


def signed_areas(points: Tensor, faces: Tensor) -> Tensor:
    """(F,) areas of triangles in a plane, such as an atlas; negative where the winding is clockwise.

    Args:
        points: (N, 2), the second axis up.
        faces: (F, 3) int64.
    """
    a, b, c = points[faces].unbind(dim=1)
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """(N, 3) unit normals: the area-weighted mean of the faces around; 0 for a vertex of no face."""
    vectors = _area_vectors(vertices, faces)
    normals = torch.zeros_like(vertices)
    for corner in range(3):
        normals = normals.index_add(0, faces[:, corner], vectors)
    return _unit(normals)


def angle_weighted_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """(N, 3) unit normals: the mean of the faces around by their angle at the vertex, as Blender shades smoothly.

    Unlike `vertex_normals` they do not change where a flat face is cut in pieces; 0 for a vertex of no face.
    """
    flat = face_normals(vertices, faces)
    angles = corner_angles(vertices, faces)
    normals = torch.zeros_like(vertices)
    for corner in range(3):
        normals = normals.index_add(0, faces[:, corner], angles[:, corner, None] * flat)
    return _unit(normals)


def corner_angles(vertices: Tensor, faces: Tensor) -> Tensor:
    """(F, 3) angles of faces at their corners, radians."""
    corners = vertices[faces]
    ahead = _unit(corners.roll(-1, dims=1) - corners)
    return angle_between(ahead, -ahead.roll(1, dims=1))


def angle_between(first: Tensor, second: Tensor) -> Tensor:
    """(...) radians between unit vectors (..., 3); 0 where one is 0."""
    # By arctangent: the arccosine of nearly 1 has no digits left.
    return torch.atan2(torch.linalg.cross(first, second, dim=-1).norm(dim=-1), (first * second).sum(dim=-1))


def in_unit_ball(vertices: Tensor) -> Tensor:
    """(N, 3) about the middle of their box, the farthest one at 1."""
    about = vertices - (vertices.amin(dim=0) + vertices.amax(dim=0)) / 2.0
    return about / about.norm(dim=1).max().clamp(min=1e-12)


def sample_surface(
    vertices: Tensor, faces: Tensor, count: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Points spread evenly over the surface.

    Args:
        vertices: (N, 3) world.
        faces: (F, 3) int64; at least one has an area.
        count: of points.
        generator: on the CPU; the same seed gives the same points on every device.
    Returns:
        (count, 3) points, (count,) int64 face of each, (count, 3) barycentric coordinates on it.
    Raises:
        ValueError: the mesh has no area.
    """
    # In float64 the running sum of a million small faces still resolves each of them.
    cumulative = face_areas(vertices, faces).double().cpu().cumsum(dim=0)
    if len(cumulative) == 0 or not float(cumulative[-1]) > 0.0:
        raise ValueError("a mesh without area has no surface to sample")
    draws = torch.rand(count, dtype=torch.float64, generator=generator) * cumulative[-1]
    face = torch.searchsorted(cumulative, draws, right=True).clamp(max=len(cumulative) - 1).to(faces.device)
    a, b = torch.rand(2, count, generator=generator)
    # The square root makes the density even; without it points crowd at the first corner.
    root = a.sqrt()
    barycentric = torch.stack([1.0 - root, root * (1.0 - b), root * b], dim=1).to(vertices)
    return (barycentric[..., None] * vertices[faces[face]]).sum(dim=1), face, barycentric


def _area_vectors(vertices: Tensor, faces: Tensor) -> Tensor:
    """(F, 3) normals whose length is twice the area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return torch.linalg.cross(b - a, c - a, dim=1)


def _unit(vectors: Tensor) -> Tensor:
    return vectors / vectors.norm(dim=-1, keepdim=True).clamp(min=MIN_LENGTH)
