"""The story of the refinement: rounds of looking where mesh and pictures part, and of moving the mesh there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from ..graphics.meshes import vertex_normals
from ..graphics.raster.rasterize import Fragments, rasterize
from ..progress import Progress, silent
from ..structures import TriangleMesh, ViewSet
from .agreement import Agreement
from .color_sweep import correlation, visibility
from .displacement import TERMS, TermsConfig, displacement
from .outline_rows import OutlineRows, outline_rows
from .picture_evidence import PictureEvidence, evidence
from .untangling import uncrossed, untangled
from .vertex_graph import VertexGraph


@dataclass(frozen=True)
class RoundConfig:
    """Where a round looks."""

    step: float
    """World units between places along the normal at which colours are compared."""
    spacing: float
    """World units between the samples of a patch. Finer ones than a blurred pixel find noise."""


ROUNDS = (RoundConfig(0.035, 0.040), RoundConfig(0.018, 0.028), RoundConfig(0.018, 0.028))
"""From coarse to fine; a run takes the first few."""

PLACES = 11
"""Along a normal; odd, for one of them is where the vertex is."""

DOUBTED = 3.0
"""Times the usual error of the views at which one counts half."""

USUAL = 1.0
"""Fine pixels: an error below that is nothing to doubt a view for."""

SWEPT = 16_000
"""Vertices at which colours are compared at most, evenly over the mesh; means over neighbours bridge the others."""

ENOUGH, ENOUGH_OF_PHOTOGRAPHS = 0.8, 0.9
"""Of the outlines' error before, what may be left: where less is gained, the pictures contradict each other.
Photographs were solved by what they have in common, so that none is another's; but their masks are guessed, and much of
their error is the masks' own, which no shape takes away."""

SETTLED = 0.5
"""How far a vertex slides along the surface towards the middle of its neighbours after a round."""


@dataclass(frozen=True)
class Refined:
    """What came of it.

    Attributes:
        mesh: the refined one, or as it was where that is not better.
        before, after: mean distance between the outlines of the mesh and of the pictures, pixels of the pictures; after
            also where the mesh was not taken.
        trust: how much each view counted in the end, 0 to 1.
        better: whether the refined mesh was taken.
    """

    mesh: TriangleMesh
    before: float
    after: float
    trust: tuple[float, ...]
    better: bool


def refine(
    mesh: TriangleMesh,
    views: ViewSet,
    rounds: int = 2,
    config: TermsConfig = TERMS,
    progress: Progress = silent,
) -> Refined:
    """`mesh` moved until it meets `views`; its faces stay as they are.

    Args:
        mesh: in the box, with edges of about one length, as an iso-surface has them.
        views: three or more, normalised.
        rounds: of `ROUNDS`.
        progress: called several times a second; what it raises passes through.
    """
    first, faces = mesh.vertices.cpu(), mesh.faces.cpu()
    pictures, graph = evidence(views), VertexGraph.of(first, faces)

    def tick(done: float) -> Callable[[], None]:
        return lambda: progress(done / (rounds + 1), "refining the shape")

    vertices, start = first, _look(first, faces, graph, pictures, views.images.device, tick(0))
    seen = start
    for number, scale in enumerate(ROUNDS[:rounds]):
        moved = _moved(seen, graph, first, scale, config, tick(number + 0.3))
        vertices = untangled(vertices, moved, graph, faces)
        if number == rounds - 1:
            vertices = uncrossed(first, vertices, graph, faces)
        seen = _look(vertices, faces, graph, pictures, views.images.device, tick(number + 1))
    enough = ENOUGH_OF_PHOTOGRAPHS if views.varying_exposure else ENOUGH
    better = seen.error(seen.trust) < enough * start.error(seen.trust)
    if not better:
        vertices = first
    pixel = float(torch.tensor([view.doubled for view in pictures]).mean())
    everywhere = torch.ones_like(seen.trust)
    return Refined(
        replace(mesh, vertices=vertices.to(mesh.vertices)),
        start.error(everywhere) / pixel,
        seen.error(everywhere) / pixel,
        tuple(seen.trust.tolist()),
        better,
    )


@dataclass(frozen=True)
class _Look:
    """A mesh beside its pictures, on their device.

    Attributes:
        vertices: (N, 3). normals: (N, 3) unit, a little smoothed. faces: (F, 3).
        pictures: what each tells.
        fragments: what the outline camera of each sees.
        rows: of each.
    """

    vertices: Tensor
    normals: Tensor
    faces: Tensor
    pictures: Sequence[PictureEvidence]
    fragments: Sequence[Fragments]
    rows: Sequence[OutlineRows]

    @property
    def trust(self) -> Tensor:
        """(V,) how much each view counts, 0 to 1."""
        return _trust(self._errors)

    @property
    def _errors(self) -> Tensor:
        return torch.tensor([row.error for row in self.rows])

    def error(self, trust: Tensor) -> float:
        """Mean distance of the outlines, fine pixels, with `trust` (V,) as weights."""
        return float((self._errors * trust).sum() / trust.sum())


def _trust(errors: Tensor) -> Tensor:
    """(V,) how much each view counts, by its error (V,): one that parts from what the others agree on is doubted."""
    usual = errors.median().clamp(min=USUAL)
    return 1.0 / (1.0 + (errors / (DOUBTED * usual)) ** 4)


def _look(
    vertices: Tensor,
    faces: Tensor,
    graph: VertexGraph,
    pictures: Sequence[PictureEvidence],
    device: torch.device,
    tick: Callable[[], None],
) -> _Look:
    normals = vertex_normals(vertices, faces)
    normals = F.normalize(normals + graph.mean(normals), dim=1)
    vertices, normals, faces = vertices.to(device), normals.to(device), faces.to(device)
    fragments, rows = [], []
    for picture in pictures:
        tick()
        fragments.append(rasterize(vertices, faces, picture.outline_camera))
        rows.append(outline_rows(vertices, normals, faces, fragments[-1], picture))
    return _Look(vertices, normals, faces, pictures, fragments, rows)


def _moved(
    look: _Look, graph: VertexGraph, home: Tensor, scale: RoundConfig, config: TermsConfig, tick: Callable[[], None]
) -> Tensor:
    """(N, 3) vertices after a round, on the CPU."""
    trust = look.trust
    seen = visibility(look.vertices, look.normals, look.pictures, look.fragments) * trust[:, None].to(look.vertices)
    skipped = torch.ones(seen.shape[1], dtype=torch.bool)
    skipped[:: -(-seen.shape[1] // SWEPT)] = False
    seen[:, skipped] = 0.0
    offsets = (torch.arange(PLACES) - PLACES // 2) * scale.step
    alike, weight = correlation(look.vertices, look.normals, seen, look.pictures, scale.spacing, offsets.to(seen), tick)
    agreement = Agreement.of(graph, offsets, alike.cpu(), weight.cpu())
    rows = [row.trusted(float(share)) for row, share in zip(look.rows, trust, strict=True)]
    vertices, normals, faces = look.vertices.cpu(), look.normals.cpu(), look.faces.cpu()
    way = displacement(graph, vertices, normals, home, rows, agreement, config, tick)
    moved = vertices + way[:, None] * normals
    # Faces that a displacement has stretched or pressed together become even again.
    towards, normals = graph.mean(moved) - moved, vertex_normals(moved, faces)
    return moved + SETTLED * (towards - (towards * normals).sum(dim=1, keepdim=True) * normals)
