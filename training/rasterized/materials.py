"""Materials that fill space: an object takes on what lies where its surface is, so it needs no texture coordinates.

A finish is a handful of materials and a division of space among them with hard borders: parts, bands, cells, patches of
wear. Materials are procedural (real metals, plastics, fabrics, varnish, rubber) or texture sets, projected along the
axis that a surface faces.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from ..random_numbers import uniform
from ..rendering.metals import METALS
from .textures import LABELS, TextureSet

Kind = Literal["even", "noise", "waves", "checks"]


@dataclass(frozen=True)
class Pattern:
    """A number in [0, 1] at every point of space.

    Attributes:
        kind: even is 0 everywhere.
        axes: (3, 3): a rotation times a frequency, per world unit.
        shift: (3,).
        lattice: (1, 1, G, G, G) random values that noise, and the wobble of the others, is interpolated from.
        hard: only 0 and 1, with borders between.
    """

    kind: Kind
    axes: Tensor
    shift: Tensor
    lattice: Tensor
    hard: bool

    def __call__(self, points: Tensor) -> Tensor:
        """(P, 1) of points (P, 3)."""
        if self.kind == "even":
            return points.new_zeros(len(points), 1)
        place = points @ self.axes + self.shift
        if self.kind == "noise":
            value = 0.6 * self._noise(place) + 0.4 * self._noise(2.3 * place)
            value = 0.5 + 1.8 * (value - 0.5)
        elif self.kind == "waves":
            value = 0.5 + 0.5 * torch.sin(math.pi * (place[:, :1] + 0.6 * self._noise(0.4 * place)))
        else:
            value = 0.5 + 0.5 * torch.sin(math.pi * place).prod(dim=1, keepdim=True)
        return (value > 0.5).to(points) if self.hard else value.clamp(0.0, 1.0)

    def _noise(self, place: Tensor) -> Tensor:
        """(P, 1) smooth, repeating with the lattice."""
        side = self.lattice.shape[-1] - 1  # Its last layer is its first.
        grid = 2.0 * place.remainder(side) / side - 1.0
        found = functional.grid_sample(self.lattice, grid.view(1, 1, 1, -1, 3), align_corners=True)
        return found.view(-1, 1)


@dataclass(frozen=True)
class Procedural:
    """Two finishes of one substance and the patterns that mix them.

    Attributes:
        label: index into `LABELS`.
        ends: (2, 5): linear albedo, roughness, metallic of either.
        color: mixes the albedo, and so also metallic. gloss: mixes the roughness.
    """

    label: int
    ends: Tensor
    color: Pattern
    gloss: Pattern

    def __call__(self, points: Tensor, normals: Tensor) -> Tensor:
        """(P, 5) at points (P, 3)."""
        color, gloss = self.color(points), self.gloss(points)
        mixed = self.ends[0] + color * (self.ends[1] - self.ends[0])
        mixed[:, 3:4] = self.ends[0, 3] + gloss * (self.ends[1, 3] - self.ends[0, 3])
        return mixed


@dataclass(frozen=True)
class Projected:
    """A texture set in space.

    Attributes:
        textures: what is shown. scale: repetitions per world unit. shift: (3,).
        tint: (3,) factor of the albedo.
    """

    textures: TextureSet
    scale: float
    shift: Tensor
    tint: Tensor

    @property
    def label(self) -> int:
        return self.textures.label

    def __call__(self, points: Tensor, normals: Tensor) -> Tensor:
        """(P, 5) at points (P, 3), seen along the axis that normals (P, 3) are closest to."""
        place = points * self.scale + self.shift
        axis = normals.abs().argmax(dim=1, keepdim=True)
        uv = torch.cat([place.gather(1, (axis + 1) % 3), place.gather(1, (axis + 2) % 3)], dim=1).remainder(1.0)
        found = functional.grid_sample(
            self.textures.maps[None], (2.0 * uv - 1.0)[None, None], padding_mode="border", align_corners=False
        )[0, :, 0].T
        return torch.cat([(found[:, :3] * self.tint).clamp(max=1.0), found[:, 3:]], dim=1)


Material = Procedural | Projected
Division = Literal["parts", "bands", "cells", "wear"]


@dataclass(frozen=True)
class Finish:
    """Materials and who of them is where.

    Attributes:
        materials: one to four.
        division: of space, or of the object's parts.
        pattern: of "wear", where it is 1 the second material shows through; its axes are those of "bands".
        seeds: (S, 3) of "cells".
    """

    materials: tuple[Material, ...]
    division: Division
    pattern: Pattern
    seeds: Tensor

    def owner(self, points: Tensor, part: Tensor) -> Tensor:
        """(P,) index of the material at points (P, 3) on parts (P,) of the object."""
        count = len(self.materials)
        if self.division == "parts":
            return part % count
        if self.division == "bands":
            return (points @ self.pattern.axes + self.pattern.shift)[:, 0].floor().long() % count
        if self.division == "cells":
            return torch.cdist(points, self.seeds).argmin(dim=1) % count
        return self.pattern(points)[:, 0].long().clamp(max=count - 1)

    def __call__(self, points: Tensor, normals: Tensor, part: Tensor) -> tuple[Tensor, Tensor]:
        """(P, 5) linear albedo, roughness, metallic in [0, 1], and (P,) int64 label, of points on the surface."""
        values, label = points.new_zeros(len(points), 5), torch.zeros(len(points), dtype=torch.int64)
        owner = self.owner(points, part)
        for index, material in enumerate(self.materials):
            mine = (owner == index).nonzero()[:, 0]
            if len(mine):
                values[mine] = material(points[mine], normals[mine])
                label[mine] = material.label
        return values.clamp(0.0, 1.0), label


def random_finish(textures: Sequence[TextureSet], generator: torch.Generator) -> Finish:
    """One to four materials, half of them texture sets where there are any."""
    count = 1 + int(torch.multinomial(torch.tensor([0.25, 0.4, 0.25, 0.1]), 1, generator=generator))
    materials = tuple(random_material(textures, generator) for _ in range(count))
    division: Division = ("parts", "bands", "cells", "wear")[_index(4, generator)]
    pattern = replace(random_pattern(generator, 0.8, 3.0), kind="noise", hard=True)
    return Finish(materials, division, pattern, 2.0 * torch.rand(12, 3, generator=generator) - 1.0)


def random_material(textures: Sequence[TextureSet], generator: torch.Generator) -> Material:
    """A texture set with a tint of its own, or a procedural substance."""
    if textures and uniform(generator) < 0.5:
        chosen = textures[_index(len(textures), generator)]
        tint = 0.7 + 0.5 * torch.rand(3, generator=generator)
        if LABELS[chosen.label] not in ("metal", "wood"):  # Their colours are known, others' are anything.
            tint = tint * (0.5 + torch.rand(3, generator=generator))
        return Projected(chosen, 0.4 + 1.2 * uniform(generator), torch.rand(3, generator=generator), tint)
    return random_substance(LABELS[_index(7, generator)], generator)


def random_substance(kind: str, generator: torch.Generator) -> Procedural:
    """A procedural material of one of `LABELS`."""
    substances: dict[str, tuple[float, float, float, float, tuple[Kind, ...]]] = {
        "metal": (1.0, 0.05, 0.6, 0.15, ("even", "noise")),
        "plastic": (0.0, 0.15, 0.7, 0.1, ("even", "even", "checks")),
        "fabric": (0.0, 0.75, 1.0, 0.1, ("checks", "waves", "noise")),
        "wood": (0.0, 0.35, 0.8, 0.15, ("waves",)),
        "stone": (0.0, 0.3, 0.95, 0.2, ("noise",)),
        "rubber": (0.0, 0.6, 1.0, 0.05, ("even",)),
        "varnish": (0.0, 0.0, 0.3, 0.05, ("even", "waves")),
    }
    metallic, low, high, spread, kinds = substances[kind]
    color = torch.rand(2, 3, generator=generator)
    if kind == "metal":
        base = torch.tensor(METALS[_index(len(METALS), generator)])
        color = base * torch.tensor([[1.0], [0.75 + 0.25 * uniform(generator)]])
    elif kind == "wood":
        color = torch.tensor([0.5, 0.3, 0.15]) * (0.4 + color.mean(dim=1, keepdim=True))
    elif kind == "rubber":
        color = 0.02 + 0.3 * color.square()
    # Two colours of one thing are closer than any two: shades of the first, or a print on it.
    if kind != "metal" and uniform(generator) < 0.6:
        color[1] = color[0] * (0.5 + 0.5 * uniform(generator))
    rough = low + (high - low) * uniform(generator)
    other = min(max(rough + spread * (2.0 * uniform(generator) - 1.0), low), high)
    ends = torch.cat([color, torch.tensor([[rough, metallic], [other, metallic]])], dim=1)
    pattern = replace(random_pattern(generator, 2.0, 12.0), kind=kinds[_index(len(kinds), generator)])
    gloss = replace(random_pattern(generator, 1.0, 6.0), kind="noise")
    return Procedural(LABELS.index(kind), ends, pattern, gloss)


def random_pattern(generator: torch.Generator, slowest: float, fastest: float) -> Pattern:
    """Noise of a frequency between two, per world unit, in any direction; hard or soft."""
    rotation = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    frequency = slowest * (fastest / slowest) ** uniform(generator)
    lattice = torch.rand(8, 8, 8, generator=generator)
    lattice = functional.pad(lattice[None, None], (0, 1, 0, 1, 0, 1), mode="circular")
    shift = 8.0 * torch.rand(3, generator=generator)
    return Pattern("noise", rotation * frequency, shift, lattice, uniform(generator) < 0.5)


def _index(count: int, generator: torch.Generator) -> int:
    return int(torch.randint(count, (), generator=generator))
