"""Folds go, and what does not fold is not touched."""

import torch

from arm_blender.refinement.untangling import folded, untangled
from arm_blender.refinement.vertex_graph import VertexGraph

from .scenes import ball, wrong_radius


def test_what_folds_over_is_undone_and_the_rest_goes_its_way():
    mesh = ball(wrong_radius, 48)
    graph = VertexGraph.of(mesh.vertices, mesh.faces)
    assert not bool(folded(mesh.vertices, graph, mesh.faces).any())
    # A cap is pushed through to the far side of its rim, the opposite half moves out a little.
    x = mesh.vertices[:, 0]
    after = mesh.vertices * (1.0 + 0.1 * (-x).clamp(min=0.0))[:, None]
    cap = x > 0.62
    after[cap, 1:] *= -0.7
    assert bool(folded(after, graph, mesh.faces).any())
    found = untangled(mesh.vertices, after, graph, mesh.faces)
    assert not bool(folded(found, graph, mesh.faces).any())
    far = x < -0.3
    assert torch.equal(found[far], after[far])


def test_a_fold_that_was_there_before_holds_nothing_back():
    mesh = ball(wrong_radius, 32)
    graph = VertexGraph.of(mesh.vertices, mesh.faces)
    flipped = mesh.faces.clone()
    flipped[0] = flipped[0].flip(0)
    assert int(folded(mesh.vertices, graph, flipped).sum()) == 1
    moved = 1.1 * mesh.vertices
    assert torch.equal(untangled(mesh.vertices, moved, graph, flipped), moved)
