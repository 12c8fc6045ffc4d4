"""Which place along its normal the pictures want a vertex at, and how sure they are."""

from dataclasses import dataclass

import torch
from torch import Tensor

from .vertex_graph import VertexGraph

MEANS = 4
"""How many times correlations are averaged over neighbours: a patch alone finds chance."""

LEAST_WEIGHT = 0.05
"""Of the pairs of views, averaged alike, below which a vertex was not compared."""

LEAST_CONFIDENCE = 0.05
"""A place that stands out from the others by less says nothing."""

COUPLING = 0.15
"""Correlation that is given up to stay one deviation nearer to where the other terms want the vertex."""


@dataclass(frozen=True)
class Agreement:
    """How alike the pictures are at K places of every vertex.

    Attributes:
        offsets: (K,) of the places along the normal, world units, evenly spaced.
        alike: (N, K) correlation, -1 to 1.
        compared: (N,) bool: whether there was anything to compare.
    """

    offsets: Tensor
    alike: Tensor
    compared: Tensor

    @staticmethod
    def of(graph: VertexGraph, offsets: Tensor, alike: Tensor, weight: Tensor) -> "Agreement":
        """Correlations (N, K) with their weights (N, K), as of `color_sweep.correlation`, averaged over neighbours."""
        both = graph.smoothed(torch.cat([alike * weight, weight], dim=1), MEANS)
        total, weight = both.split(len(offsets), dim=1)
        return Agreement(offsets, total / weight.clamp(min=1e-4), weight.amin(dim=1) > LEAST_WEIGHT)

    def places(self, near: Tensor, deviation: float) -> tuple[Tensor, Tensor]:
        """The best places (N,), world units along the normals, and how sure (N,) they are, 0 to 1.

        Args:
            near: (N,) where the other terms want the vertices.
            deviation: world units that the place may well be away from there (the coupling of DTAM, Newcombe et al.
                2011: loose at first, then tight).
        """
        last = len(self.offsets) - 1
        far = (near[:, None] - self.offsets) / deviation
        best = (self.alike - COUPLING * far.square()).argmax(dim=1)
        inner = best.clamp(1, last - 1)
        before, at, after = (self.alike.gather(1, (inner + k)[:, None])[:, 0] for k in (-1, 0, 1))
        bend = (before - 2.0 * at + after).clamp(max=-1e-6)  # A parabola through three places has its top between.
        between = (0.5 * (before - after) / bend).clamp(-1.0, 1.0)
        sure = 2.0 * (at - self.alike.mean(dim=1)).clamp(min=0.0) * at.clamp(min=0.0)
        sure = torch.where(self.compared & (best == inner) & (sure > LEAST_CONFIDENCE), sure.clamp(max=1.0), 0.0)
        return self.offsets[inner] + between * (self.offsets[1] - self.offsets[0]), sure
