"""Which faces cross, against pairs tried one by one, and surfaces that do not."""

import pytest
import torch
import trimesh

from arm_blender.graphics.intersections import _pierces, crossing_faces


def sphere(center: float) -> tuple[torch.Tensor, torch.Tensor]:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    return torch.from_numpy(ball.vertices).float() + torch.tensor([center, 0.0, 0.0]), torch.from_numpy(ball.faces)


def two(distance: float) -> tuple[torch.Tensor, torch.Tensor]:
    (a, faces), (b, _) = sphere(0.0), sphere(distance)
    return torch.cat([a, b]), torch.cat([faces, faces + len(a)])


def test_a_sphere_crosses_nothing():
    assert not len(crossing_faces(*sphere(0.0)))


@pytest.mark.parametrize(("distance", "crosses"), [(1.01, False), (0.9, True), (0.3, True)])
def test_spheres_cross_where_they_meet(distance, crosses):
    vertices, faces = two(distance)
    pairs = crossing_faces(vertices, faces)
    assert bool(len(pairs)) == crosses
    half = len(faces) // 2
    assert bool(((pairs[:, 0] < half) & (pairs[:, 1] >= half)).all())


def test_all_crossings_are_found():
    generator = torch.Generator().manual_seed(0)
    centers = torch.rand(150, 1, 3, generator=generator)
    vertices = (centers + 0.2 * torch.randn(150, 3, 3, generator=generator)).view(-1, 3)
    faces = torch.arange(450).view(-1, 3)
    corners = vertices[faces].double()
    i, j = torch.triu_indices(150, 150, 1)
    expected = _pierces(corners[i], corners[j]) | _pierces(corners[j], corners[i])
    assert crossing_faces(vertices, faces).tolist() == torch.stack([i, j], 1)[expected].tolist()
    assert 100 < int(expected.sum()) < len(i) // 2


def test_a_needle_goes_through_a_face_and_not_past_it():
    face = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    through = torch.tensor([[[0.2, 0.2, -1.0], [0.2, 0.2, 1.0], [0.21, 0.2, 1.0]]])
    assert bool(_pierces(through, face)) and not bool(_pierces(face, through))
    assert not bool(_pierces(through + torch.tensor([0.7, 0.7, 0.0]), face))
    assert not bool(_pierces(through + torch.tensor([0.0, 0.0, 1.5]), face))
