"""Marching cubes: closed, on the surface, equal to its dense form and to an independent implementation."""

import math

import numpy as np
import pytest
import torch
from skimage.measure import marching_cubes
from torch import Tensor

from arm_blender.errors import Cancelled, EmptyMeshError
from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, crossed_edges, extract, vertices_from_densities
from arm_blender.graphics.surface.sample_grid import Density
from arm_blender.structures import TriangleMesh

ISO = 10.0


def ball(p: Tensor, radius: float = 0.7) -> Tensor:
    return ISO + 50.0 * (radius - p.norm(dim=1))


def torus(p: Tensor) -> Tensor:
    return ISO + 50.0 * (0.2 - torch.hypot(p[:, :2].norm(dim=1) - 0.6, p[:, 2]))


def two_parts(p: Tensor) -> Tensor:
    shift = torch.tensor([0.45, 0.3, 0.1])
    return torch.maximum(ball(p - shift, 0.3), ball(p + shift, 0.07))


def thin_plate(p: Tensor) -> Tensor:
    """Thinner than two cells at every resolution at which it is compared with the dense surface."""
    return ISO + 50.0 * (0.03 - torch.maximum((p[:, 2] - 0.137).abs(), p[:, :2].abs().amax(dim=1) - 0.7))


def waves(p: Tensor) -> Tensor:
    """Bumps of some ten samples, cut open by the box."""
    frequency = torch.tensor([[7.0, 3.0, 1.0], [2.0, 6.0, 4.0], [5.0, -3.0, 6.0]])
    return ISO + 5.0 * torch.sin(p @ frequency).sum(dim=1)


def step(p: Tensor) -> Tensor:
    return 20.0 * (p.norm(dim=1) < 0.7)


def from_grid(values: Tensor) -> Density:
    """A density that knows only the samples (R, R, R), x first, of a grid over the box."""
    resolution = values.shape[0]

    def density(p: Tensor) -> Tensor:
        x, y, z = ((p + 1.0) / 2.0 * (resolution - 1)).round().long().unbind(dim=1)
        return values[x, y, z]

    return density


def assert_closed(mesh: TriangleMesh) -> None:
    """Every directed edge occurs once, and its opposite once."""
    edges = torch.cat([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    forward = edges[:, 0] * len(mesh.vertices) + edges[:, 1]
    backward = edges[:, 1] * len(mesh.vertices) + edges[:, 0]
    assert len(forward.unique()) == len(forward)
    assert torch.equal(forward.sort().values, backward.sort().values)


def volume(mesh: TriangleMesh) -> float:
    a, b, c = mesh.vertices[mesh.faces].double().unbind(dim=1)
    return float((a * torch.linalg.cross(b, c)).sum() / 6.0)


def euler_number(mesh: TriangleMesh) -> int:
    return len(mesh.vertices) - len(mesh.faces) * 3 // 2 + len(mesh.faces)


@pytest.mark.parametrize("density", [ball, torus, two_parts, thin_plate, waves, step])
@pytest.mark.parametrize("resolution", [33, 48])
def test_the_sparse_surface_equals_the_dense_one(density, resolution):
    sparse = extract(density, IsosurfaceConfig(resolution))
    dense = extract(density, IsosurfaceConfig(resolution, block=7, dense=True))
    assert torch.equal(sparse.faces, dense.faces)
    torch.testing.assert_close(sparse.vertices, dense.vertices, rtol=0.0, atol=1e-5)


def test_no_sample_is_evaluated_twice_and_few_are_needed():
    asked = []

    def density(p: Tensor) -> Tensor:
        asked.append(p)
        return ball(p)

    extract(density, IsosurfaceConfig(97, chunk=10_000))
    points = torch.cat(asked)
    assert max(len(part) for part in asked) <= 10_000
    assert len(points.unique(dim=0)) == len(points) < 0.3 * 97**3


@pytest.mark.parametrize("density", [ball, torus, two_parts, thin_plate])
def test_the_cost_grows_with_the_surface(density):
    """Twice as fine: about four times as many samples, not eight. On coarse grids a plate's two sides share some."""
    asked = []

    def counted(p: Tensor) -> Tensor:
        asked[-1] += len(p)
        return density(p)

    for resolution in (65, 129, 257):
        asked.append(0)
        extract(counted, IsosurfaceConfig(resolution))
    assert asked[1] < 5.5 * asked[0] and asked[2] < 5.5 * asked[1]


def test_a_part_that_is_seen_at_256_is_seen_on_a_finer_grid():
    config = [IsosurfaceConfig(resolution) for resolution in (64, 256, 257, 512, 1024)]
    assert [c.search_halvings for c in config] == [2, 2, 3, 3, 4]
    assert max((c.resolution - 1) / (c.block << c.search_halvings) for c in config) <= 32
    with pytest.raises(ValueError, match="halvings 0"):
        IsosurfaceConfig(16, halvings=0)


@pytest.mark.parametrize("density", [ball, torus, waves])
def test_the_vertices_are_those_of_an_independent_implementation(density):
    resolution = 32
    line = torch.linspace(-1.0, 1.0, resolution)
    grid = torch.stack(torch.meshgrid(line, line, line, indexing="ij"), dim=-1).reshape(-1, 3)
    values = density(grid).reshape((resolution,) * 3)
    values[[0, -1]] = values[:, [0, -1]] = values[:, :, [0, -1]] = 0.0  # skimage leaves surfaces open at the box.
    ours = extract(from_grid(values), IsosurfaceConfig(resolution))
    theirs, faces, _, _ = marching_cubes(values.numpy(), ISO, method="lorensen")
    theirs = theirs[np.unique(faces)] * 2.0 / (resolution - 1) - 1.0
    theirs = np.unique(theirs.round(6), axis=0)  # It does not weld vertices at samples.

    distance = torch.cdist(ours.vertices.double(), torch.from_numpy(theirs).double())
    spacing = 2.0 / (resolution - 1)
    assert float(distance.amin(dim=0).max()) < 2e-3 * spacing
    assert float(distance.amin(dim=1).max()) < 2e-3 * spacing


@pytest.mark.parametrize("case", range(0, 256, 16))
def test_every_case_of_the_table_closes_with_its_neighbours(case):
    for pattern in range(case, case + 16):
        values = torch.zeros(4, 4, 4)
        for corner in range(8):
            values[1 + (corner & 1), 1 + (corner >> 1 & 1), 1 + (corner >> 2)] = 20.0 * (pattern >> corner & 1)
        if pattern:
            mesh = extract(from_grid(values), IsosurfaceConfig(4, dense=True))
            assert_closed(mesh)
            assert volume(mesh) > 0.0


@pytest.mark.parametrize("seed", range(4))
def test_noise_closes_also_where_the_box_cuts_it(seed):
    values = torch.randn(13, 13, 13, generator=torch.Generator().manual_seed(seed)) + ISO
    mesh = extract(from_grid(values), IsosurfaceConfig(13, dense=True))
    assert_closed(mesh)
    corners = mesh.vertices[mesh.faces]
    areas = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1)
    assert float(areas.min()) > 0.0
    assert len(mesh.faces.unique()) == len(mesh.vertices)


def test_a_ball_has_its_volume_points_outwards_and_has_no_hole():
    mesh = extract(ball, IsosurfaceConfig(64))
    assert_closed(mesh)
    assert euler_number(mesh) == 2
    assert volume(mesh) == pytest.approx(4.0 / 3.0 * math.pi * 0.7**3, rel=2e-3)
    # Between the chord and the arc of one cell: spacing**2 / (8 r).
    spacing = 2.0 / 63
    assert float((mesh.vertices.norm(dim=1) - 0.7).abs().max()) < spacing**2 / (8 * 0.7) * 1.5


def test_a_torus_has_one_hole():
    mesh = extract(torus, IsosurfaceConfig(48))
    assert_closed(mesh)
    assert euler_number(mesh) == 0
    assert volume(mesh) == pytest.approx(2.0 * math.pi**2 * 0.6 * 0.2**2, rel=2e-2)


def test_a_body_of_two_holes_has_two():
    """Two tori that touch: genus 2, Euler number 2 - 2 * 2."""

    def density(p: Tensor) -> Tensor:
        side = torch.tensor([0.42, 0.0, 0.0])
        return torch.maximum(
            *(ISO + 50.0 * (0.12 - torch.hypot((p + s * side)[:, :2].norm(dim=1) - 0.36, p[:, 2])) for s in (-1, 1))
        )

    mesh = extract(density, IsosurfaceConfig(64))
    assert_closed(mesh)
    assert euler_number(mesh) == -2


def test_what_fills_the_box_ends_at_the_box():
    mesh = extract(lambda p: torch.full((len(p),), 20.0), IsosurfaceConfig(10))
    assert_closed(mesh)
    assert euler_number(mesh) == 2
    assert volume(mesh) == pytest.approx(8.0, rel=1e-6)
    assert len(mesh.faces) == 6 * 9 * 9 * 2


def test_infinite_density_is_inside_and_no_number_is_outside():
    values = torch.zeros(5, 5, 5)
    values[2, 2, 2] = torch.inf
    values[2, 2, 1] = torch.nan
    mesh = extract(from_grid(values), IsosurfaceConfig(5, dense=True))
    # One sample in the middle, half a spacing of 0.5 around it: an octahedron.
    expected = {(s * 0.25 * (k == 0), s * 0.25 * (k == 1), s * 0.25 * (k == 2)) for k in range(3) for s in (1, -1)}
    assert {tuple(v) for v in mesh.vertices.tolist()} == expected
    assert_closed(mesh)


@pytest.mark.parametrize("level", [0.0, torch.nan, -torch.inf, ISO])
def test_no_surface_is_an_error_that_names_the_remedy(level):
    with pytest.raises(EmptyMeshError, match="--dense"):
        extract(lambda p: torch.full((len(p),), level), IsosurfaceConfig(16))


def test_a_density_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"\(\d+, 3\) points has shape \(\d+, 1\)"):
        extract(lambda p: ball(p)[:, None], IsosurfaceConfig(16))


def test_the_callback_can_stop_the_evaluation():
    asked = []

    def stop(fraction: float, message: str) -> None:
        assert 0.0 <= fraction <= 1.0
        if len(asked) == 2:
            raise Cancelled("stopped")

    def density(p: Tensor) -> Tensor:
        asked.append(len(p))
        return ball(p)

    with pytest.raises(Cancelled):
        extract(density, IsosurfaceConfig(32, chunk=500), stop)
    assert len(asked) == 2


def test_progress_never_goes_back():
    """Nor does it stand still near the end: the coarse samples, here one in 50, do not count for the fine ones."""
    heard = []
    extract(waves, IsosurfaceConfig(48, chunk=500), lambda fraction, message: heard.append(fraction))
    assert len(heard) > 20 and heard == sorted(heard)
    assert 0.3 < heard[len(heard) // 2] < 0.7


def test_vertices_recomputed_from_their_edges_are_those_of_the_mesh():
    config = IsosurfaceConfig(32)
    mesh = extract(waves, config)
    edges = crossed_edges(waves, config)
    assert torch.equal(edges.faces, mesh.faces)
    vertices = vertices_from_densities(edges.a, edges.b, waves(edges.a), waves(edges.b), ISO)
    torch.testing.assert_close(vertices, mesh.vertices, rtol=0.0, atol=1e-5)


def test_a_growing_ball_pushes_its_vertices_outwards():
    edges = crossed_edges(ball, IsosurfaceConfig(48))
    radius = torch.tensor(0.7, requires_grad=True)
    vertices = vertices_from_densities(edges.a, edges.b, ball(edges.a, radius), ball(edges.b, radius), ISO)
    # Along its edge a vertex moves by dr / cos(angle of edge and normal): radially, by dr.
    radial = (vertices * torch.nn.functional.normalize(vertices.detach(), dim=1)).sum(dim=1)
    (gradient,) = torch.autograd.grad(radial.mean(), radius)
    assert float(gradient) == pytest.approx(1.0, abs=0.01)


def test_gradients_are_those_of_finite_differences():
    edges = crossed_edges(waves, IsosurfaceConfig(10))
    keep = (edges.a != edges.b).any(dim=1).nonzero()[::7, 0]
    inputs = [x[keep].double().requires_grad_() for x in (edges.a, edges.b, edges.density_a, edges.density_b)]
    share = ((ISO - inputs[2]) / (inputs[3] - inputs[2])).detach()
    assert len(keep) > 20 and float(share.min()) > 2e-3 and float(share.max()) < 1.0 - 2e-3  # Not where it is clamped.
    assert torch.autograd.gradcheck(lambda *x: vertices_from_densities(*x, ISO), inputs)


def test_gradients_are_finite_where_densities_are_not():
    a, b = torch.zeros(4, 3), torch.ones(4, 3)
    density_a = torch.tensor([20.0, torch.inf, 20.0, ISO], requires_grad=True)
    density_b = torch.tensor([0.0, 0.0, torch.nan, ISO], requires_grad=True)
    vertices = vertices_from_densities(a, b, density_a, density_b, ISO)
    torch.testing.assert_close(vertices, torch.full((4, 3), 0.5))
    vertices.sum().backward()
    assert density_a.grad.isfinite().all() and density_b.grad.isfinite().all()
    # x = (iso - da) / (db - da): dx/da = (iso - db) / (db - da)**2, three coordinates.
    assert float(density_a.grad[0]) == pytest.approx(3 * 10.0 / 400.0)
