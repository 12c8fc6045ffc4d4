"""Samples of a density on a grid over [-1, 1]^3, kept block by block; `block_search` decides where to take them.

The samples lie in one flat array of `side`^3 (x fastest) with at least one layer around the box that counts as empty,
so that the surface is closed. A block is a cube of `block`^3 cells of that array.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

Density = Callable[[Tensor], Tensor]
"""(P,) density of (P, 3) world points."""


@dataclass(frozen=True)
class IsosurfaceConfig:
    """How finely, and at which value, a density becomes a mesh."""

    resolution: int = 128
    """Samples along each side of the box. Thinner parts than 2 / (resolution - 1) are lost."""
    iso: float = 10.0
    """Inside is density > iso, in the units of the density: activated or raw, as the caller's function returns it."""
    block: int = 2
    """Cells along a side of a block, the smallest cube that is sampled as a whole."""
    halvings: int | None = None
    """Of the cubes that the search for blocks starts from, until they are blocks; at least 1. Parts that leave no trace
    on the corners and middles of those cubes are missed. None stands for 2, and for one more whenever the grid is twice
    as fine as 256: what is seen at 256 is then seen on finer grids, for as many first samples."""
    slope: float | None = None
    """How much the density changes along a world unit at most (a Lipschitz constant), where one is known: then the
    surface is that of dense evaluation, however small its parts. None judges by how neighbouring samples differ."""
    dense: bool = False
    """Evaluate every sample. Slower; finds parts of any size."""
    chunk: int = 2**17
    """Points in one call of the density: bounds its memory."""

    def __post_init__(self) -> None:
        if self.resolution < 2 or self.block < 1 or self.chunk < 1 or self.search_halvings < 1:
            raise ValueError(
                f"resolution {self.resolution} >= 2, block {self.block} >= 1, chunk {self.chunk} >= 1, "
                f"halvings {self.search_halvings} >= 1"
            )

    @property
    def search_halvings(self) -> int:
        """`halvings`, or what None stands for."""
        if self.halvings is not None:
            return self.halvings
        return 2 + max(0, math.ceil(math.log2(self.resolution / 256)))


@dataclass
class BlockSamples:
    """The array, and which of its blocks are active.

    Attributes:
        resolution: samples of the box along a side; they have the indices 1..resolution of the array.
        block: cells along a side of a block.
        cube: blocks along a side of a cube; the array holds whole cubes.
        iso: inside is value > iso.
        device: of the tensors.
        blocks: along a side of the array.
        side: samples of the array along a side.
        values: (side^3,) float32; NaN where nothing was evaluated.
        in_box: (side^3,) bool.
        active: (blocks, blocks, blocks) bool, z first.
        evaluated: number of samples that the density was asked for.
    """

    resolution: int
    block: int
    cube: int
    iso: float
    device: torch.device
    values: Tensor = field(init=False)
    in_box: Tensor = field(init=False)
    active: Tensor = field(init=False)
    evaluated: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self.blocks = -(-(self.resolution + 1) // (self.block * self.cube)) * self.cube
        self.side = self.blocks * self.block + 1
        index = torch.arange(self.side, device=self.device)
        inner = (index >= 1) & (index <= self.resolution)
        self.in_box = (inner[:, None, None] & inner[:, None] & inner).flatten()
        self.values = torch.full((self.side**3,), torch.nan, device=self.device)
        self.active = torch.zeros((self.blocks,) * 3, dtype=torch.bool, device=self.device)
        self._known = ~self.in_box

    @property
    def highest(self) -> float | None:
        """The highest value found, None where there is none."""
        numbers = self.values[~self.values.isnan()]
        return float(numbers.max()) if len(numbers) else None

    def points(self, flat: Tensor) -> Tensor:
        """(P, 3) world positions of (P,) samples of the array inside the box."""
        line = torch.linspace(-1.0, 1.0, self.resolution, device=self.device)
        x, y, z = flat % self.side, flat // self.side % self.side, flat // self.side**2
        return torch.stack([line[x - 1], line[y - 1], line[z - 1]], dim=1)

    def unknown(self, flat: Tensor) -> Tensor:
        """The distinct ones of (P,) samples that are in the box and not yet evaluated, in the array's order."""
        return flat[~self._known[flat]].unique()

    def store(self, flat: Tensor, values: Tensor) -> None:
        """Enter what the density said at (P,) samples."""
        self.values[flat] = values
        self._known[flat] = True
        self.evaluated += len(flat)

    def inside(self, blocks: Tensor) -> Tensor:
        """(A, block + 1, block + 1, block + 1) bool, z first: which samples of (A,) blocks lie inside."""
        return self.values[self.samples_of(blocks)] > self.iso  # NaN compares False: outside.

    def samples_of(self, blocks: Tensor) -> Tensor:
        """(A, block + 1, block + 1, block + 1) flat samples, z first, of (A,) flat blocks."""
        line = torch.arange(self.block + 1, device=self.device)
        local = (line[:, None, None] * self.side + line[:, None]) * self.side + line
        return self._first_sample(blocks)[:, None, None, None] + local

    def _first_sample(self, blocks: Tensor) -> Tensor:
        x, y, z = blocks % self.blocks, blocks // self.blocks % self.blocks, blocks // self.blocks**2
        return ((z * self.side + y) * self.side + x) * self.block

    def crossed_cells(self) -> tuple[Tensor, Tensor]:
        """Cells of active blocks that the surface crosses: (C,) flat first samples and (C,) marching-cubes cases."""
        blocks = self.active.flatten().nonzero().flatten()
        inside = self.inside(blocks).to(torch.int32)
        n = self.block
        case = torch.zeros((len(blocks), n, n, n), dtype=torch.int32, device=self.device)
        for corner in range(8):
            right, back, up = corner & 1, corner >> 1 & 1, corner >> 2 & 1
            case |= inside[:, up : up + n, back : back + n, right : right + n] << corner
        block, z, y, x = ((case > 0) & (case < 255)).nonzero().unbind(dim=1)
        # In the array's order, the mesh does not depend on the size of the blocks.
        first, order = (self._first_sample(blocks)[block] + (z * self.side + y) * self.side + x).sort()
        return first, case[block, z, y, x].long()[order]
