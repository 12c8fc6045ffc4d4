"""Which faces of a mesh hang together: components, pairs of faces across edges, and the manifold cut."""

import torch
from torch import Tensor


def components(links: Tensor, count: int) -> Tensor:
    """Connected components of an undirected graph.

    Args:
        links: (L, 2) int64, pairs of nodes.
        count: number of nodes.
    Returns:
        (count,) int64: component of each node, 0, 1, ... in the order of their first nodes.
    """
    label = torch.arange(count, device=links.device)
    a, b = links.unbind(dim=1)
    while True:
        # Every component's root takes the lowest label that a link shows it; then all labels jump to their root.
        lowest = torch.minimum(label[a], label[b])
        parent = label.scatter_reduce(0, torch.cat([label[a], label[b]]), lowest.repeat(2), "amin")
        while not torch.equal(parent, jumped := parent[parent]):
            parent = jumped
        parent = parent[label]
        if torch.equal(parent, label):
            return torch.unique(label, return_inverse=True)[1]
        label = parent


def half_edges(faces: Tensor) -> Tensor:
    """(F * 3, 2) directed edges of (F, 3) faces; edge k of face f, from its corner k to the next, is row 3 * f + k."""
    return torch.stack([faces, faces.roll(-1, dims=1)], dim=-1).reshape(-1, 2)


def neighbours_of_vertices(faces: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """(E,) neighbours of vertex 0, of vertex 1 and so on, each once; and (count,) where each vertex's begin."""
    edges = half_edges(faces)
    pairs = torch.unique(torch.cat([edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]]))
    degrees = torch.bincount(pairs // count, minlength=count)
    return pairs % count, degrees.cumsum(0) - degrees


def manifold_pairs(faces: Tensor) -> Tensor:
    """(E, 2) rows of `half_edges` that form an edge of exactly two faces with opposite directions."""
    edges = half_edges(faces)
    low, high = edges.amin(dim=1), edges.amax(dim=1)
    key, order = (low * (edges.max() + 1 if len(edges) else 1) + high).sort()
    _, count = torch.unique_consecutive(key, return_counts=True)
    first = (torch.cumsum(count, dim=0) - count)[count == 2]
    pairs = torch.stack([order[first], order[first + 1]], dim=1)
    return pairs[edges[pairs[:, 0], 0] == edges[pairs[:, 1], 1]]


def face_components(faces: Tensor) -> Tensor:
    """(F,) int64: which part each face belongs to; parts that share a vertex are one."""
    if not len(faces):
        return faces.new_zeros(0)
    vertex_part = components(half_edges(faces), int(faces.max()) + 1)
    return torch.unique(vertex_part[faces[:, 0]], return_inverse=True)[1]


def cut_nonmanifold(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """The same surface with vertices doubled so that every edge has at most two faces, of the same orientation, and
    the faces around every vertex form one fan.

    Args:
        vertices: (N, 3). faces: (F, 3) int64.
    Returns:
        (M, 3) and (F, 3); both unchanged where the mesh was manifold. A doubled vertex follows the others.
    """
    pairs = manifold_pairs(faces)
    this, other = pairs[:, 0], pairs[:, 1]
    # Across an edge, the first corner of one half-edge is the last of the other.
    links = torch.cat([torch.stack([this, _following(other)], 1), torch.stack([_following(this), other], 1)])
    fans = components(links, faces.numel())
    corners = faces.flatten()
    origin = corners.new_zeros(int(fans.max()) + 1 if len(fans) else 0).scatter_(0, fans, corners)
    # The first fan of a vertex keeps its number.
    keeper = origin.new_full((len(vertices),), len(origin)).scatter_reduce(
        0, origin, torch.arange(len(origin), device=faces.device), "amin"
    )
    doubled = keeper[origin] != torch.arange(len(origin), device=faces.device)
    number = torch.where(doubled, len(vertices) + torch.cumsum(doubled, dim=0) - 1, origin)
    return torch.cat([vertices, vertices[origin[doubled]]]), number[fans].reshape(-1, 3)


def _following(corner: Tensor) -> Tensor:
    """The next corner of the same face: the end of the half-edge that has the number of its first corner."""
    return corner // 3 * 3 + (corner + 1) % 3
