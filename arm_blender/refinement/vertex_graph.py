"""The vertices of a mesh as a graph: means over neighbours, and how bent the surface is when it is moved.

On the CPU, whatever the pictures lie on: the sums are short, and a bag of indices runs there on every machine.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from ..graphics.connectivity import half_edges, neighbours_of_vertices


@dataclass(frozen=True)
class VertexGraph:
    """Which vertices are neighbours.

    Attributes:
        neighbour: (E,) neighbours of vertex 0, of vertex 1 and so on.
        begin: (N,) where those of each vertex begin.
        owner: (E,) whose neighbour each is.
        share: (E,) one over the owner's number of neighbours.
        edge: mean length of an edge when the graph was made.
    """

    neighbour: Tensor
    begin: Tensor
    owner: Tensor
    share: Tensor
    edge: float

    @staticmethod
    def of(vertices: Tensor, faces: Tensor) -> "VertexGraph":
        """That of a mesh on the CPU."""
        neighbour, begin = neighbours_of_vertices(faces, len(vertices))
        degree = torch.diff(begin, append=begin.new_tensor([len(neighbour)]))
        owner = torch.repeat_interleave(degree)
        start, end = vertices[half_edges(faces)].unbind(dim=1)
        return VertexGraph(neighbour, begin, owner, 1.0 / degree[owner], float((start - end).norm(dim=1).mean()))

    def mean(self, values: Tensor) -> Tensor:
        """(N, C) or (N,): of every vertex the mean over its neighbours; 0 for a vertex that has none."""
        columns = values if values.ndim == 2 else values[:, None]
        return F.embedding_bag(self.neighbour, columns, self.begin, mode="mean").view_as(values)

    def smoothed(self, values: Tensor, times: int) -> Tensor:
        """(N, C) halfway to the mean over neighbours, so many times."""
        for _ in range(times):
            values = 0.5 * (values + self.mean(values))
        return values


@dataclass(frozen=True)
class Bending:
    """How bent a surface is along its normals, as a linear function of a displacement along them.

    n . (x - mean over neighbours) of every vertex; the operator is I - S.

    Attributes:
        graph: of the mesh.
        forth: (E,) weights of S, a row for each owner.
        back: (E,) weights of its transpose, a row for each owner.
        still: (N,) the bend before any displacement.
    """

    graph: VertexGraph
    forth: Tensor
    back: Tensor
    still: Tensor

    @staticmethod
    def of(graph: VertexGraph, vertices: Tensor, normals: Tensor) -> "Bending":
        """That of vertices (N, 3) which move along unit normals (N, 3)."""
        cosine = (normals[graph.owner] * normals[graph.neighbour]).sum(dim=1)
        degree = torch.diff(graph.begin, append=graph.begin.new_tensor([len(graph.neighbour)]))
        still = (normals * (vertices - graph.mean(vertices))).sum(dim=1)
        return Bending(graph, graph.share * cosine, cosine / degree[graph.neighbour], still)

    def change(self, displacement: Tensor) -> Tensor:
        """(N,) of the bend, by displacements (N,)."""
        return displacement - self._bag(self.forth, displacement)

    def transposed(self, values: Tensor) -> Tensor:
        """(N,) by the transpose of `change`."""
        return values - self._bag(self.back, values)

    def diagonal(self, weight: Tensor) -> Tensor:
        """(N,) diagonal of the square of `change`, with weights (N,) of its rows."""
        return weight + self._bag(self.back.square(), weight)

    def _bag(self, weights: Tensor, values: Tensor) -> Tensor:
        graph = self.graph
        return F.embedding_bag(graph.neighbour, values[:, None], graph.begin, mode="sum", per_sample_weights=weights)[
            :, 0
        ]
