"""Keep a moved surface from folding over and from passing through itself.

Where it folds, its vertices go to the middle of their neighbours; where nothing helps, they stay as they were.
"""

import torch
from torch import Tensor

from ..graphics.intersections import crossing_faces
from ..graphics.meshes import face_normals, vertex_normals
from .vertex_graph import VertexGraph

EVENED, KEPT = 4, 16
"""Times that what folds is evened out, which is enough for most of it; then, that it is left as it was before, with one
ring more of what is around it each time: three do nearly always."""

SOFT = 6
"""Rings over which a part that is left as it was passes into what has moved."""


def untangled(before: Tensor, after: Tensor, graph: VertexGraph, faces: Tensor) -> Tensor:
    """(N, 3) vertices `after`, changed a little where faces would fold over that did not `before`.

    Args:
        before: (N, 3). after: (N, 3). faces: (F, 3).
    Returns:
        (N, 3); `before` itself where nothing else helps.
    """
    known = folded(before, graph, faces)
    kept, evened = torch.zeros(len(before), 1), after
    moved = after
    for attempt in range(EVENED + KEPT):
        new = folded(moved, graph, faces) & ~known
        if not bool(new.any()):
            return moved
        if attempt < EVENED:
            touched = torch.zeros(len(before), 1)
            touched[faces[new].flatten()] = 1.0
            evened = torch.lerp(moved, graph.mean(moved), graph.mean(touched).clamp(min=0.5 * touched))
            moved = evened
        else:
            kept = _widened(kept, new, graph, faces)
            moved = torch.lerp(evened, before, torch.maximum(kept, graph.smoothed(kept, SOFT)))
    return before


def uncrossed(before: Tensor, after: Tensor, graph: VertexGraph, faces: Tensor) -> Tensor:
    """(N, 3) vertices `after`, left as they were `before` around faces that would pass through others.

    Args:
        before: (N, 3). after: (N, 3). faces: (F, 3).
    Returns:
        (N, 3); no faces cross, or fold over, that did not before.
    """
    known, known_folds = None, folded(before, graph, faces)
    kept, moved = torch.zeros(len(before), 1), after
    for _ in range(KEPT):
        pairs = crossing_faces(moved, faces)
        if len(pairs) and known is None:
            known = torch.zeros(len(faces), dtype=torch.bool)
            known[crossing_faces(before, faces).flatten()] = True
        new = folded(moved, graph, faces) & ~known_folds
        if known is not None:
            new[pairs[~known[pairs].all(dim=1)].flatten()] = True
        if not bool(new.any()):
            return moved
        kept = _widened(kept, new, graph, faces)
        moved = torch.lerp(after, before, torch.maximum(kept, graph.smoothed(kept, SOFT)))
    return before


def _widened(kept: Tensor, more: Tensor, graph: VertexGraph, faces: Tensor) -> Tensor:
    """(N, 1) 1 for the vertices of `kept` and of the faces `more` (F,), and for a ring around them."""
    kept = kept.clone()
    kept[faces[more].flatten()] = 1.0
    return torch.maximum(kept, (graph.mean(kept) > 0.0).to(kept))


def folded(vertices: Tensor, graph: VertexGraph, faces: Tensor) -> Tensor:
    """(F,) bool: faces that look the other way than the surface around them."""
    around = vertex_normals(vertices, faces)
    around = around + graph.mean(around)
    return (face_normals(vertices, faces) * around[faces].sum(dim=1)).sum(dim=1) < 0.0
