"""Keep a moved surface from folding over: where it does, its vertices go to the middle of their neighbours."""

import torch
from torch import Tensor

from ..graphics.meshes import face_normals, vertex_normals
from .vertex_graph import VertexGraph

ATTEMPTS = 20
"""Of evening out what folds; most folds are gone after three."""


def untangled(before: Tensor, after: Tensor, graph: VertexGraph, faces: Tensor) -> Tensor:
    """(N, 3) vertices `after`, evened out where faces would fold over that did not `before`.

    Args:
        before: (N, 3). after: (N, 3). faces: (F, 3).
    Returns:
        (N, 3); `before` itself where nothing else helps.
    """
    known = folded(before, graph, faces)
    moved = after
    for _ in range(ATTEMPTS):
        new = folded(moved, graph, faces) & ~known
        if not bool(new.any()):
            return moved
        touched = torch.zeros(len(before), 1)
        touched[faces[new].flatten()] = 1.0
        moved = torch.lerp(moved, graph.mean(moved), graph.mean(touched).clamp(min=0.5 * touched))
    return before


def folded(vertices: Tensor, graph: VertexGraph, faces: Tensor) -> Tensor:
    """(F,) bool: faces that look the other way than the surface around them."""
    around = vertex_normals(vertices, faces)
    around = around + graph.mean(around)
    return (face_normals(vertices, faces) * around[faces].sum(dim=1)).sum(dim=1) < 0.0
