"""Tangents are those of MikkTSpace: of a plane in closed form, of any mesh those of Blender."""

import math

import pytest
import torch

from arm_blender.graphics.meshes import angle_weighted_normals, corner_angles
from arm_blender.graphics.tangents import corner_tangents
from arm_blender.structures import UvMesh


def square(uvs: torch.Tensor) -> UvMesh:
    """A unit square in the plane z = 0, of two triangles."""
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    return UvMesh(corners, faces, uvs, faces, 1)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 200.0])
@pytest.mark.parametrize("mirrored", [False, True])
def test_tangent_and_bitangent_of_a_plane_follow_its_uvs(degrees, mirrored):
    angle = math.radians(degrees)
    turn = torch.tensor([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    mesh = square(torch.zeros(4, 2))
    uvs = mesh.vertices[:, :2] @ turn.T  # u grows along the first row, v along the second.
    if mirrored:
        uvs[:, 0] = -uvs[:, 0]
    tangents, sign = corner_tangents(square(uvs), angle_weighted_normals(mesh.vertices, mesh.faces))
    u = torch.cat([turn[0] * (-1.0 if mirrored else 1.0), torch.zeros(1)])
    v = torch.cat([turn[1], torch.zeros(1)])
    up = torch.tensor([0.0, 0.0, 1.0])
    torch.testing.assert_close(tangents, u.expand(2, 3, 3), atol=1e-6, rtol=0.0)
    bitangents = sign[:, None, None] * torch.linalg.cross(up.expand_as(tangents), tangents)
    torch.testing.assert_close(bitangents, v.expand(2, 3, 3), atol=1e-6, rtol=0.0)


def test_without_uvs_there_is_no_tangent():
    mesh = square(torch.zeros(4, 2))
    tangents, _ = corner_tangents(mesh, angle_weighted_normals(mesh.vertices, mesh.faces))
    assert not tangents.any()


def test_angles_of_a_triangle_add_up_to_half_a_turn():
    vertices = torch.rand(60, 3, generator=torch.Generator().manual_seed(0))
    angles = corner_angles(vertices, torch.arange(60).view(-1, 3))
    torch.testing.assert_close(angles.sum(dim=1), torch.full((20,), math.pi), atol=1e-5, rtol=0.0)


def test_normals_by_angle_do_not_depend_on_how_a_face_is_cut():
    """A corner of a cube: however its three squares are halved, the normal is their mean."""
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
    squares = [(0, 3, 2, 1), (0, 1, 5, 4), (0, 4, 6, 3)]
    faces = []
    for a, b, c, d in squares[:1]:
        faces += [(a, b, c), (a, c, d)]
    for a, b, c, d in squares[1:]:
        faces += [(a, b, d), (b, c, d)]
    normal = angle_weighted_normals(vertices, torch.tensor(faces))[0]
    torch.testing.assert_close(normal, torch.full((3,), -(3.0**-0.5)), atol=1e-6, rtol=0.0)
