"""Components, pairs across edges, and the manifold cut."""

import pytest
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from arm_blender.graphics.connectivity import components, cut_nonmanifold, face_components, manifold_pairs

TETRAHEDRON = torch.tensor([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


@pytest.mark.parametrize("links", [0, 300, 900, 3000])
def test_components_are_those_of_scipy(links):
    nodes = 1000
    pairs = torch.randint(0, nodes, (links, 2), generator=torch.Generator().manual_seed(links))
    count, expected = connected_components(
        coo_matrix(([1] * links, pairs.T.numpy()), shape=(nodes, nodes)), directed=False
    )
    label = components(pairs, nodes)
    assert torch.equal(label, torch.from_numpy(expected).long()) and int(label.max()) + 1 == count


def test_a_long_chain_in_any_order_is_one_component():
    order = torch.randperm(5000, generator=torch.Generator().manual_seed(0))
    assert int(components(torch.stack([order[:-1], order[1:]], dim=1), 5000).max()) == 0


def test_faces_that_share_no_vertex_are_two_parts():
    faces = torch.cat([TETRAHEDRON, TETRAHEDRON + 4])
    assert face_components(faces).tolist() == [0] * 4 + [1] * 4


def test_each_edge_of_a_closed_surface_is_one_pair():
    pairs = manifold_pairs(TETRAHEDRON)
    assert len(pairs) == 6
    assert sorted(pairs.flatten().tolist()) == list(range(12))


def test_edges_of_one_direction_are_no_pair():
    assert len(manifold_pairs(torch.tensor([[0, 1, 2], [0, 1, 3]]))) == 0


def test_a_manifold_mesh_is_not_cut():
    vertices = torch.rand(5, 3)  # One vertex is of no face.
    cut_vertices, cut_faces = cut_nonmanifold(vertices, TETRAHEDRON)
    assert torch.equal(cut_vertices, vertices) and torch.equal(cut_faces, TETRAHEDRON)


@pytest.mark.parametrize("shared", [1, 2])
def test_bodies_that_touch_in_a_vertex_or_an_edge_come_apart(shared):
    # Vertices 0..shared-1 belong to both.
    second = torch.tensor([0, 1, 2, 3]) + 4
    second[:shared] = torch.arange(shared)
    faces = torch.cat([TETRAHEDRON, second[TETRAHEDRON]])
    vertices = torch.rand(8, 3, generator=torch.Generator().manual_seed(0))
    cut_vertices, cut_faces = cut_nonmanifold(vertices, faces)
    assert torch.equal(cut_vertices[cut_faces], vertices[faces])
    assert face_components(cut_faces).tolist() == [0] * 4 + [1] * 4
    assert len(manifold_pairs(cut_faces)) == 12
