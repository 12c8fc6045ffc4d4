"""Areas, normals and samples of meshes against closed forms."""

import math

import pytest
import torch
from torch import Tensor

from arm_blender.graphics.meshes import face_areas, face_normals, sample_surface, signed_areas, vertex_normals


def cube() -> tuple[Tensor, Tensor]:
    """The cube [-1, 1]^3, wound outwards; two triangles a side, with corners of 4 and of 5 faces."""
    vertices = torch.tensor([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, torch.tensor([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])


def test_faces_of_a_cube_point_outwards_with_area_two() -> None:
    vertices, faces = cube()
    normals = face_normals(vertices, faces)
    centers = vertices[faces].mean(dim=1)
    assert ((normals * centers).sum(dim=1) > 0).all()
    torch.testing.assert_close(normals.abs().sum(dim=1), torch.ones(12))
    torch.testing.assert_close(face_areas(vertices, faces), torch.full((12,), 2.0))


def test_areas_in_the_plane_are_signed_by_the_winding() -> None:
    corners = torch.tensor([[0.0, 0.0], [4.0, 0.0], [0.0, 3.0], [8.0, -3.0]])
    areas = signed_areas(corners, torch.tensor([[0, 1, 2], [0, 2, 1], [1, 2, 3]]))
    assert areas.tolist() == [6.0, -6.0, 0.0]  # The last three lie on one line.


def test_vertex_normals_weigh_faces_by_area() -> None:
    # A flat fan of many slivers beside one large face: the slivers' number must not matter, only their area.
    fan = torch.linspace(0, math.pi / 2, 9)
    rim = torch.stack([fan.cos(), fan.sin(), torch.zeros(9)], dim=1)
    vertices = torch.cat([torch.zeros(1, 3), rim, torch.tensor([[0.0, 0.0, 2.0]])])
    faces = torch.tensor([[0, i + 1, i + 2] for i in range(8)] + [[0, 10, 1]])  # up (+Z), and a wall that faces +Y
    up, wall = 8 * 0.5 * math.sin(math.pi / 16), 1.0
    expected = torch.tensor([0.0, wall, up]) / math.hypot(up, wall)
    torch.testing.assert_close(vertex_normals(vertices, faces)[0], expected, atol=1e-5, rtol=0)


def test_normals_without_a_direction_are_zero() -> None:
    vertices = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [5.0, 5.0, 5.0]])
    assert torch.equal(face_normals(vertices, torch.tensor([[0, 1, 2]])), torch.zeros(1, 3))
    assert torch.equal(vertex_normals(vertices, torch.tensor([[0, 1, 2]])), torch.zeros(4, 3))
    tiny = vertices.clone()
    tiny[2] = torch.tensor([0.0, 1.0, 0.0])
    expected = torch.tensor([[0.0, 0.0, 1.0]])
    torch.testing.assert_close(face_normals(tiny * 1e-6, torch.tensor([[0, 1, 2]])), expected)


def test_samples_spread_evenly_over_the_surface() -> None:
    vertices, faces = cube()
    vertices = torch.cat([vertices, torch.tensor([[9.0, 9.0, 9.0]])])
    faces = torch.cat([torch.tensor([[8, 8, 8]]), faces])  # A face without area is never hit.
    count = 60_000
    points, face, barycentric = sample_surface(vertices, faces, count, torch.Generator().manual_seed(0))
    assert (face > 0).all() and (barycentric >= 0).all()
    torch.testing.assert_close(barycentric.sum(dim=1), torch.ones(count))
    torch.testing.assert_close(points.abs().amax(dim=1), torch.ones(count))
    deviation = math.sqrt(count * (1 / 12) * (11 / 12))
    assert ((torch.bincount(face, minlength=13)[1:] - count / 12).abs() < 5 * deviation).all()
    # Over a cube's surface E[x^2] is (2 sides of 1 + 4 sides of 1/3) / 6 = 5/9.
    torch.testing.assert_close((points**2).mean(dim=0), torch.full((3,), 5 / 9), atol=0.01, rtol=0)


def test_the_seed_fixes_the_samples_and_an_empty_mesh_has_none() -> None:
    vertices, faces = cube()
    first, second = (sample_surface(vertices, faces, 50, torch.Generator().manual_seed(4))[0] for _ in range(2))
    assert torch.equal(first, second)
    with pytest.raises(ValueError, match="without area"):
        sample_surface(vertices * 0.0, faces, 5, torch.Generator())
    with pytest.raises(ValueError, match="without area"):
        sample_surface(vertices, faces[:0], 5, torch.Generator())
