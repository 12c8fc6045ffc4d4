"""One displacement a vertex that answers outlines, agreement of the pictures, smoothness and the mesh as it came."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from .agreement import Agreement
from .conjugate_gradient import solved
from .outline_rows import OutlineRows
from .vertex_graph import Bending, VertexGraph


@dataclass(frozen=True)
class TermsConfig:
    """How much each term counts: the deviation that is taken for natural, world units."""

    outline: float = 0.003
    """Of a pixel of an outline. Less follows the steps of masks, more leaves the outline where it was."""
    color: float = 0.008
    """Of a place at which the pictures agree fully; of others 1 over the root of how sure they are times as much."""
    plate: float = 0.0007
    """Of the bend of a vertex against its neighbours. Less flattens relief, more leaves the surface rough."""
    anchor: float = 0.06
    """Of a vertex from where it was before all rounds. What no picture shows is held by this alone."""
    unseen: float = 0.03
    """The same of a vertex that fewer than two pictures show."""
    edge: float = 0.028
    """Length of the edges of a mesh for which the deviations are meant: a finer one has more vertices to share them."""
    crease: float = 0.05
    """Edge lengths that a vertex may be bent before it is taken for a crease, which may stay."""
    solves: int = 3
    """Creases and places are chosen anew before each."""
    furthest: float = 0.1
    """That a vertex is moved at most."""


TERMS = TermsConfig()

TOLERANCE = 1e-3
"""Of a solve: a ten-thousandth of the box, less than anything that is told apart here."""

TIGHTER = 0.7
"""How much tighter places and displacement are coupled from solve to solve."""


def displacement(
    graph: VertexGraph,
    vertices: Tensor,
    normals: Tensor,
    home: Tensor,
    rows: Sequence[OutlineRows],
    agreement: Agreement,
    config: TermsConfig,
    tick: Callable[[], None],
) -> Tensor:
    """(N,) world units along the normals.

    Args:
        graph: of the mesh.
        vertices: (N, 3). normals: (N, 3) unit.
        home: (N, 3) where the vertices are anchored.
        rows: of each view.
        agreement: of the pictures.
        tick: called now and then; what it raises passes through.
    """
    share = (graph.edge / config.edge) ** 2  # Of a vertex, of what one of a mesh with the usual edges stands for.
    held = torch.where(agreement.compared, share / config.anchor**2, share / config.unseen**2)
    wanted = held * ((home - vertices) * normals).sum(dim=1)
    for row in rows:
        weight = row.weight / config.outline**2
        held = held.index_add(0, row.vertex, weight * row.cosine.square())
        wanted = wanted.index_add(0, row.vertex, weight * row.cosine * row.gap)
    bending = Bending.of(graph, vertices, normals)
    moved, coupling = torch.zeros_like(held), 1.7 * float(agreement.offsets[1] - agreement.offsets[0])
    for _ in range(config.solves):
        tick()
        bent = graph.mean((bending.still + bending.change(moved)).abs()) / (config.crease * graph.edge)
        stiff = 1.0 / (1.0 + bent.square()) / (config.plate**2 * share)  # Cauchy's weights: a crease bends freely.
        place, sure = agreement.places(moved, coupling)
        sure = sure * share / config.color**2
        moved = _solved(bending, stiff, held + sure, wanted + sure * place, moved, tick)
        moved = moved.clamp(-config.furthest, config.furthest)
        coupling *= TIGHTER
    return moved


def _solved(
    bending: Bending, stiff: Tensor, held: Tensor, wanted: Tensor, start: Tensor, tick: Callable[[], None]
) -> Tensor:
    """(N,) x that minimises sum stiff * (still + change(x))**2 + sum held * x**2 - 2 sum wanted * x."""
    return solved(
        lambda x: bending.transposed(stiff * bending.change(x)) + held * x,
        held + bending.diagonal(stiff),
        wanted - bending.transposed(stiff * bending.still),
        start,
        TOLERANCE,
        tick,
    )
