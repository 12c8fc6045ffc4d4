"""Short waves go, long ones stay, and nothing else moves."""

import math

import pytest
import torch

from arm_blender.graphics.meshes import vertex_normals
from arm_blender.graphics.surface.fairing import FairingConfig, fair, low_pass
from arm_blender.structures import TriangleMesh

SIDE = 96
STEP = 0.02


def sheet(wavelength: float) -> tuple[torch.Tensor, torch.Tensor]:
    """A plane of equilateral triangles with waves of height 1 along x, and which vertices lie far from its edge."""
    row, column = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    x = STEP * (column + 0.5 * (row % 2))
    y = STEP * math.sqrt(0.75) * row
    vertices = torch.stack([x, y, torch.cos(2.0 * math.pi * x / wavelength)], dim=-1).view(-1, 3)
    inside = ((row > 24) & (row < SIDE - 24) & (column > 24) & (column < SIDE - 24)).view(-1)
    return vertices, inside


def faces() -> torch.Tensor:
    """Of `sheet`: six around every inner vertex."""
    found = []
    for row in range(SIDE - 1):
        for column in range(SIDE - 1):
            a, b, c, d = (r * SIDE + k for r in (row, row + 1) for k in (column, column + 1))
            found += [(a, b, c), (b, d, c)] if row % 2 == 0 else [(a, b, d), (a, d, c)]
    return torch.tensor(found)


def kept(vertices: torch.Tensor, wavelength: float, limit: float) -> float:
    """The share of the waves' height that the filter leaves; heights are small, so that edges keep their length."""
    flat = vertices * torch.tensor([1.0, 1.0, 1e-4])
    after = low_pass(flat, faces(), limit)
    _, inside = sheet(wavelength)
    return float((after[inside, 2] * vertices[inside, 2]).sum() / (flat[inside, 2] * vertices[inside, 2]).sum())


@pytest.mark.parametrize("ratio, low, high", [(3.0, 0.97, 1.03), (1.0, 0.35, 0.65), (0.4, -0.02, 0.02)])
def test_waves_are_kept_or_taken_by_their_length(ratio, low, high):
    limit = 0.14
    vertices, _ = sheet(ratio * limit)
    assert low <= kept(vertices, ratio * limit, limit) <= high


def icosphere(subdivisions: int) -> TriangleMesh:
    trimesh = pytest.importorskip("trimesh")
    made = trimesh.creation.icosphere(subdivisions)
    return TriangleMesh(torch.tensor(made.vertices).float(), torch.tensor(made.faces).long())


def test_a_ball_keeps_its_radius_and_loses_its_roughness():
    mesh = icosphere(4)
    generator = torch.Generator().manual_seed(0)
    rough = mesh.vertices * (1.0 + 0.01 * torch.randn(len(mesh.vertices), 1, generator=generator))
    smooth = low_pass(rough, mesh.faces, 0.6)
    assert abs(float(smooth.norm(dim=1).mean()) - 1.0) < 2e-3
    assert float(smooth.norm(dim=1).std()) < 0.3 * float(rough.norm(dim=1).std())
    before, after = (vertex_normals(v, mesh.faces) for v in (rough, smooth))
    assert float((after * mesh.vertices).sum(dim=1).mean()) > float((before * mesh.vertices).sum(dim=1).mean())


def test_where_a_surface_lies_and_how_it_is_turned_does_not_matter():
    mesh = icosphere(3)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1)))[0]
    away = torch.tensor([5.0, -3.0, 2.0])
    moved = low_pass(mesh.vertices @ turn.T + away, mesh.faces, 0.5)
    torch.testing.assert_close(moved, low_pass(mesh.vertices, mesh.faces, 0.5) @ turn.T + away, atol=2e-5, rtol=0.0)


def test_nothing_happens_where_nothing_is_asked_for_or_can_be_told_apart():
    mesh = icosphere(2)
    assert torch.equal(fair(mesh, FairingConfig()).vertices, mesh.vertices)
    torch.testing.assert_close(low_pass(mesh.vertices, mesh.faces, 1e-3), mesh.vertices, atol=1e-5, rtol=0.0)


def test_swelling_moves_along_the_normals():
    mesh = icosphere(3)
    grown = fair(mesh, FairingConfig(swell=0.1))
    torch.testing.assert_close(grown.vertices.norm(dim=1), torch.full((len(mesh.vertices),), 1.1), atol=1e-4, rtol=0.0)
    assert torch.equal(grown.faces, mesh.faces)
