"""The plate's operator and its solves against scipy's, in float64."""

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
import torch

from arm_blender.graphics.meshes import vertex_normals
from arm_blender.refinement.conjugate_gradient import solved
from arm_blender.refinement.displacement import TERMS
from arm_blender.refinement.vertex_graph import Bending, VertexGraph
from training.studies.extremes.pebble import ball, wrong_radius


@pytest.fixture(scope="module")
def bending() -> Bending:
    mesh = ball(wrong_radius, 40)
    return Bending.of(
        VertexGraph.of(mesh.vertices, mesh.faces), mesh.vertices, vertex_normals(mesh.vertices, mesh.faces)
    )


def matrix(bending: Bending) -> scipy.sparse.csr_matrix:
    """Of `change`, in float64."""
    graph, count = bending.graph, len(bending.still)
    entries = (bending.forth.double().numpy(), (graph.owner.numpy(), graph.neighbour.numpy()))
    return (scipy.sparse.identity(count) - scipy.sparse.coo_matrix(entries, shape=(count, count))).tocsr()


def test_the_plate_and_its_transpose_are_one_matrix(bending):
    x = torch.randn(len(bending.still), generator=torch.Generator().manual_seed(0))
    exact = matrix(bending)
    np.testing.assert_allclose(bending.change(x).numpy(), exact @ x.numpy(), atol=1e-5)
    np.testing.assert_allclose(bending.transposed(x).numpy(), exact.T @ x.numpy(), atol=1e-5)
    weight = x.abs()
    squared = exact.T @ scipy.sparse.diags(weight.double().numpy()) @ exact
    np.testing.assert_allclose(bending.diagonal(weight).numpy(), squared.diagonal(), rtol=1e-5)


def test_a_solve_is_that_of_scipy(bending):
    generator = torch.Generator().manual_seed(1)
    count = len(bending.still)
    # A third of the vertices is held by outlines, the rest by the anchor alone: as stiff as it gets.
    held = torch.where(torch.rand(count, generator=generator) < 0.33, 1e5, 1.0 / TERMS.anchor**2)
    wanted = held * 0.02 * torch.randn(count, generator=generator)
    stiff = torch.full((count,), 1.0 / TERMS.plate**2)
    right = wanted - bending.transposed(stiff * bending.still)
    found = solved(
        lambda x: bending.transposed(stiff * bending.change(x)) + held * x,
        held + bending.diagonal(stiff),
        right,
        torch.zeros(count),
    )
    exact = matrix(bending)
    system = exact.T @ exact / TERMS.plate**2 + scipy.sparse.diags(held.double().numpy())
    expected = scipy.sparse.linalg.spsolve(system.tocsc(), right.double().numpy())
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-4)


def test_a_system_that_is_solved_already_is_left_alone():
    x = torch.tensor([1.0, -2.0, 3.0])
    asked = []

    def product(values: torch.Tensor) -> torch.Tensor:
        asked.append(values)
        return 4.0 * values

    assert torch.equal(solved(product, torch.full((3,), 4.0), 4.0 * x, x), x) and len(asked) == 1
