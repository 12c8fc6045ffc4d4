"""Roughness and metallic, read off what the views show by one linear map that a hundred objects are enough for.

Not in the paper, whose GlossyRM learns both end to end, from many times as many objects with measured maps. With as few
as there are, large networks learn those by heart and know nothing of others. So: evidence that physics and the
pictures give (finish_evidence.py), of the point and of the whole object, and ridge regression
(`python -m training fit finish`). docs/materials.md has what it knows and what it does not.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ...structures import TriangleMesh, UvMesh, ViewSet
from ...uv.backproject import BackprojectConfig, look, sight
from ...uv.view_sampling import sample_view
from .delighting import SeenPoints
from .finish_evidence import NAMES, evidence

COUNT = len(NAMES)
"""Numbers of a point."""

SUMMARIES = 5
"""Of each number over the object: mean, deviation, and the values below which a tenth, half and nine tenths lie."""

NEAREST = 8
"""Points whose finish a cell takes, the nearer the more."""

CELLS_AT_ONCE = 4096

_DRAWN = 2
"""Times as many points are looked for, since views do not see all."""

_BENT = 0.1
"""World units by which points with opposite normals are apart besides: of the two sides of a sheet."""


@dataclass(frozen=True)
class FinishConfig:
    """How points are taken from an atlas, and what is believed."""

    points: int = 1024
    """That are looked at. As many as in training, so that neighbours are as far."""
    picture: int = 176
    """Pixels a side of the pictures in training; larger ones are read as if they had no more."""
    resolution: int = 256
    """Cells a side of the maps at most; there are no more points behind them."""
    least_views: int = 3
    """Fewer views have the usual finish: of objects that were left out, one view told nothing."""
    several_views: int = 5
    """Views from which on there is another read-out than for fewer: what points show over three views is noisier."""
    bound: float = 3.0
    """Deviations from the usual at which a number is cut: beyond them training saw nothing."""
    strange: float = 1.5
    """Mean square of an object's numbers, in deviations, from which on it is unlike those of training, whose own is 1:
    what is said of it then falls back to the usual."""
    sure: float = 0.8
    """Probability from which on a point is called metal."""


@dataclass(frozen=True)
class FoundFinish:
    """P points.

    Attributes:
        roughness: (P,) in [0, 1].
        metallic: (P,) 1 where it is surer of metal than `FinishConfig.sure`, else 0.
        metal: (P,) probability that it is metal.
        trust: in [0, 1], how like those of training the object is; 0 gives the usual finish.
    """

    roughness: Tensor
    metallic: Tensor
    metal: Tensor
    trust: Tensor


class Standard(nn.Module):
    """Numbers in deviations from their mean, cut."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.mean = nn.Parameter(torch.zeros(count))
        self.scale = nn.Parameter(torch.ones(count))

    def forward(self, x: Tensor, bound: float) -> Tensor:
        return ((x - self.mean) * self.scale).clamp(-bound, bound)


class Readout(nn.Module):
    """From the numbers of points to roughness and a score of metal, and what that is worth."""

    def __init__(self) -> None:
        super().__init__()
        self.point, self.object = Standard(COUNT), Standard(SUMMARIES * COUNT)
        self.answer = nn.Linear((1 + SUMMARIES) * COUNT, 2)
        self.odds = nn.Linear(1, 1)  # Makes the score a logit.
        self.ceiling = nn.Parameter(torch.ones(()))  # However high a score, it was no more often right than so.

    def told(self, x: Tensor, summary: Tensor, bound: float) -> Tensor:
        """(P, 6 N) of the numbers (P, N) and their object's summary (5 N,), in deviations from the usual."""
        whole = self.object(summary, bound)
        return torch.cat([self.point(x, bound), whole.expand(len(x), -1)], dim=1)

    def metal(self, score: Tensor) -> Tensor:
        """The probability of metal at scores of any shape."""
        return torch.minimum(torch.sigmoid(self.odds(score[..., None]))[..., 0], self.ceiling)


class Finish(nn.Module):
    """Seen points to roughness and metallic."""

    def __init__(self, config: FinishConfig) -> None:
        super().__init__()
        self.config = config
        self.several, self.few = Readout(), Readout()

    def forward(self, points: SeenPoints) -> FoundFinish:
        """The finish of each point; of one object, B = 1."""
        views = points.visible.shape[1]
        if views < self.config.least_views:
            return self.usual(points)
        return self.read(evidence(points), views)

    @property
    def usual_roughness(self) -> Tensor:
        """() of what nothing is known of, in [0, 1]."""
        return self.several.answer.bias[0].clamp(0.0, 1.0)

    def usual(self, points: SeenPoints) -> FoundFinish:
        """The same finish for all points."""
        rough = self.usual_roughness.expand(points.position.shape[1])
        none = torch.zeros_like(rough)
        return FoundFinish(rough, none, none, rough.new_zeros(()))

    def read(self, found: Tensor, views: int) -> FoundFinish:
        """The finish of points whose evidence is `found` (P, N), seen by so many views."""
        readout = self.readout(views)
        answer, trust = self.answer(readout, found, summary(found))
        metal = readout.metal(answer[:, 1])
        return FoundFinish(answer[:, 0].clamp(0.0, 1.0), (metal > self.config.sure).float(), metal, trust)

    def readout(self, views: int) -> Readout:
        """What reads points of so many views."""
        return self.several if views >= self.config.several_views else self.few

    def answer(self, readout: Readout, found: Tensor, whole: Tensor) -> tuple[Tensor, Tensor]:
        """(P, 2) roughness and score of metal, of no bounds, by what `readout` reads; and the trust in it.

        Args:
            found: (P, N). whole: (5 N,) their object's summary.
        """
        told = readout.told(found, whole, self.config.bound)
        strangeness = told[0, found.shape[1] :].square().mean()
        trust = (self.config.strange / strangeness.clamp(min=1e-6)).clamp(max=1.0)
        return readout.answer.bias + trust * (told @ readout.answer.weight.T), trust

    @torch.no_grad()
    def maps(self, surface: Tensor, points: SeenPoints | None) -> Tensor:
        """(2, n, n) roughness and metallic of cells; 0 where no chart lies.

        Args:
            surface: (7, n, n), as of `surface_cells`.
            points: of it, as of `seen_points`; None gives the usual finish.
        """
        covered = surface[0] > 0.0
        result = surface.new_zeros(2, *covered.shape)
        if points is None:
            result[0, covered] = self.usual_roughness
            return result
        found = self(points)
        values = torch.stack([found.roughness, found.metallic], dim=1)
        result[:, covered] = spread(values, _place(points.position[0], points.normal[0]), _place(*_cells(surface))).T
        return result


def summary(x: Tensor) -> Tensor:
    """(5 N,) of numbers (P, N) of one object."""
    quantiles = x.quantile(x.new_tensor([0.1, 0.5, 0.9]), dim=0)
    return torch.cat([x.mean(dim=0), x.std(dim=0, correction=0), quantiles.flatten()])


def seen_points(
    mesh: TriangleMesh | UvMesh,
    views: ViewSet,
    surface: Tensor,
    config: FinishConfig,
    check: Callable[[], None] = lambda: None,
) -> SeenPoints | None:
    """Points of a surface that views see, evenly chosen from its cells; None where none is seen.

    Grazing views and those close to an outline are asked as well: the blend of colours is better off without them, but
    it is there that all that is smooth mirrors most.

    Args:
        mesh: what hides them.
        surface: (7, n, n) cells of its atlas, as of `surface_cells`.
        check: called for every view; what it raises passes through.
    """
    place, normal = _cells(surface)
    chosen = _evenly(len(place), _DRAWN * config.points, place.device)
    place, normal = place[chosen], normal[chosen]
    shown, visible = [], []
    sharp = BackprojectConfig()
    for image, camera in zip(views.images, views.cameras, strict=True):
        check()
        pixels, facing = look(camera, place, normal)
        step = torch.full_like(facing, max(1.0, camera.height / config.picture))
        color, found = sample_view(image, pixels, step, sharp.min_alpha)
        shown.append(color.T)
        visible.append(sight(mesh, place, normal, facing, step, image, camera, sharp)[0] & found)
    color, sights = torch.stack(shown), torch.stack(visible)
    known = sights.any(dim=0).nonzero()[:, 0]
    if not len(known):
        return None
    eyes = torch.stack([camera.center for camera in views.cameras])
    points = SeenPoints(place[None], normal[None], color[None], sights[None], eyes[None])
    return points.only(known[_evenly(len(known), config.points, known.device)])


def spread(values: Tensor, places: Tensor, wanted: Tensor) -> Tensor:
    """(Q, C) at places (Q, D) of the values (P, C) that are known at places (P, D)."""
    parts = []
    for some in wanted.split(CELLS_AT_ONCE):
        distance, index = torch.cdist(some, places).topk(min(NEAREST, len(places)), largest=False)
        weight = 1.0 / (distance + 1e-3)
        parts.append((weight[..., None] * values[index]).sum(dim=1) / weight.sum(dim=1, keepdim=True))
    return torch.cat(parts) if parts else values.new_zeros(0, values.shape[1])


def _cells(surface: Tensor) -> tuple[Tensor, Tensor]:
    covered = surface[0] > 0.0
    return surface[1:4, covered].T, nn.functional.normalize(surface[4:, covered].T, dim=1)


def _evenly(count: int, most: int, device: torch.device) -> Tensor:
    """Indices of `most` of `count` at most."""
    return torch.linspace(0, count - 1, min(count, most), device=device).long()


def _place(position: Tensor, normal: Tensor) -> Tensor:
    """(P, 6) by which points are near one another."""
    return torch.cat([position, 0.5 * _BENT * normal], dim=1)
