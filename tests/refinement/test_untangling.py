"""Folds go, and what does not fold is not touched."""

import torch

from arm_blender.graphics.intersections import crossing_faces
from arm_blender.graphics.surface.isosurface import extract
from arm_blender.graphics.surface.sample_grid import IsosurfaceConfig
from arm_blender.refinement.untangling import folded, uncrossed, untangled
from arm_blender.refinement.vertex_graph import VertexGraph
from training.studies.extremes.pebble import ball, wrong_radius

GRID = IsosurfaceConfig(48, iso=0.0)


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


def test_walls_do_not_pass_through_each_other():
    gap = extract(
        lambda p: 20.0 * (0.06 - (p[:, 0].abs() - 0.12).abs()).minimum(0.5 - p[:, 1:].abs().amax(dim=1)), GRID
    )
    graph = VertexGraph.of(gap.vertices, gap.faces)
    x, rest = gap.vertices[:, :1], gap.vertices[:, 1:]
    inner = (x.abs() < 0.1).float() * (-6.0 * rest.square().sum(dim=1, keepdim=True)).exp()
    # Two walls side by side, each bulging into the other.
    after = torch.cat([x - 0.1 * x.sign() * inner, rest], dim=1)
    assert len(crossing_faces(after, gap.faces)) and not len(crossing_faces(gap.vertices, gap.faces))
    found = uncrossed(gap.vertices, after, graph, gap.faces)
    assert not len(crossing_faces(found, gap.faces))
    moved, meant = ((points - gap.vertices).norm(dim=1).sum() for points in (found, after))
    assert 0.0 < float(moved) < float(meant)
