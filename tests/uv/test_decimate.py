"""Cleaning and decimation, on surfaces with a closed form."""

import math

import pytest
import torch
from torch import Tensor

from arm_blender.errors import EmptyMeshError
from arm_blender.graphics.connectivity import manifold_pairs
from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, extract
from arm_blender.structures import TriangleMesh
from arm_blender.uv.decimate import clean, decimate


def sphere(resolution: int = 48, radius: float = 0.7) -> TriangleMesh:
    return extract(lambda p: 10.0 + radius - p.norm(dim=1), IsosurfaceConfig(resolution))


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    vertices, faces, start = [], [], 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces + start)
        start += len(mesh.vertices)
    return TriangleMesh(torch.cat(vertices), torch.cat(faces))


def moved(mesh: TriangleMesh, scale: float = 1.0, shift: float = 0.0) -> TriangleMesh:
    return TriangleMesh(mesh.vertices * scale + shift, mesh.faces)


def turned_inside_out(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.faces.flip(1))


def volume(mesh: TriangleMesh) -> float:
    a, b, c = mesh.vertices[mesh.faces].double().unbind(dim=1)
    return float((a * torch.linalg.cross(b, c)).sum() / 6.0)


def is_closed(mesh: TriangleMesh) -> bool:
    return len(manifold_pairs(mesh.faces)) * 2 == mesh.faces.numel()


def assert_same(a: TriangleMesh, b: TriangleMesh) -> None:
    assert torch.equal(a.vertices, b.vertices) and torch.equal(a.faces, b.faces)


BALL = sphere(32)


def test_a_clean_mesh_stays_as_it_is():
    assert_same(clean(BALL), BALL)


def test_floaters_go_and_parts_stay():
    part, floater = moved(BALL, 0.3, 1.5), moved(BALL, 0.05, -1.5)
    assert_same(clean(joined(BALL, part, floater)), joined(BALL, part))
    assert_same(clean(joined(floater, part, BALL), min_part=0.0), joined(floater, part, BALL))
    assert_same(clean(joined(floater, part, BALL), min_part=0.2), BALL)


def test_the_wall_of_a_hollow_goes():
    assert_same(clean(joined(turned_inside_out(moved(BALL, 0.5)), BALL)), BALL)


def test_the_largest_part_stays_even_if_it_faces_inwards():
    inwards = turned_inside_out(BALL)
    assert_same(clean(joined(inwards, moved(BALL, 0.5, 2.0))), joined(inwards, moved(BALL, 0.5, 2.0)))


def test_an_open_sheet_is_no_hollow():
    sheet = TriangleMesh(BALL.vertices, BALL.faces[BALL.vertices[BALL.faces][..., 2].amin(dim=1) > 0].flip(1))
    assert len(clean(joined(BALL, moved(sheet, 1.0, 3.0))).faces) == len(BALL.faces) + len(sheet.faces)


def test_broken_faces_go():
    vertices = torch.cat([BALL.vertices, torch.tensor([[torch.nan, 0.0, 0.0], [5.0, 5.0, 5.0]])])
    count = len(BALL.vertices)
    broken = torch.tensor(
        [
            [0, 1, count],  # Not a number.
            [2, 2, 3],  # A corner twice.
            BALL.faces[7].roll(1).tolist(),  # There already.
        ]
    )
    assert_same(clean(TriangleMesh(vertices, torch.cat([BALL.faces, broken]))), BALL)


def test_a_mesh_without_area_is_an_error():
    with pytest.raises(EmptyMeshError):
        clean(TriangleMesh(torch.zeros(3, 3), torch.tensor([[0, 1, 2]])))


def test_a_mesh_within_the_budget_is_returned():
    assert decimate(BALL, len(BALL.faces)) is BALL


@pytest.mark.parametrize("faces", [4000, 1000, 200])
def test_a_decimated_sphere_stays_a_sphere(faces):
    mesh = decimate(sphere(), faces)
    assert 0.98 * faces <= len(mesh.faces) <= faces
    assert is_closed(mesh)
    assert len(mesh.vertices) - len(mesh.faces) // 2 == 2
    # Equal equilateral triangles of side s: s**2 = 16 pi r**2 / (sqrt(3) F); they sink by s**2 / (6 r) at the middle.
    sagitta = 16 * math.pi * 0.7 / (math.sqrt(3) * faces) / 6
    assert float((mesh.vertices.norm(dim=1) - 0.7).abs().max()) < sagitta + 1e-3
    assert volume(mesh) == pytest.approx(4 / 3 * math.pi * 0.7**3, rel=3 * sagitta + 2e-3)
    normals = torch.linalg.cross(*(mesh.vertices[mesh.faces].diff(dim=1).unbind(dim=1)))
    assert bool(((normals * mesh.vertices[mesh.faces].mean(dim=1)).sum(dim=1) > 0).all())


def test_decimation_does_not_depend_on_size_and_place():
    mesh = sphere()
    small, large = decimate(mesh, 1000), decimate(moved(mesh, 64.0, 0.0), 1000)
    assert torch.equal(small.faces, large.faces)
    torch.testing.assert_close(small.vertices * 64.0, large.vertices, rtol=0.0, atol=1e-4)


def test_a_decimated_tangle_has_no_edge_of_three_faces():
    noise = torch.randn(1, 1, 16, 16, 16, generator=torch.Generator().manual_seed(0))

    def density(p: Tensor) -> Tensor:
        return torch.nn.functional.grid_sample(noise, p[None, :, None, None], align_corners=True).flatten() + 9.5

    mesh = decimate(clean(extract(density, IsosurfaceConfig(48, dense=True))), 2000)
    edges = torch.stack([mesh.faces, mesh.faces.roll(-1, dims=1)], dim=-1).reshape(-1, 2).sort(dim=1).values
    assert int(edges.unique(dim=0, return_counts=True)[1].max()) == 2
    assert len(mesh.faces) <= 2000


def test_a_budget_that_closes_nothing_is_refused():
    with pytest.raises(ValueError, match="at least 4"):
        decimate(BALL, 3)
