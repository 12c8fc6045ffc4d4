"""Samples of a density on a grid over [-1, 1]^3, taken block by block, only where its iso-surface can be.

The samples lie in one flat array of `side`^3 (x fastest) with at least one layer around the box that counts as empty,
so that the surface is closed. A block is a cube of `block`^3 cells of that array.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
import torch.nn.functional as F
from torch import Tensor

from ..progress import Progress

NEARNESS = 0.75
"""A block is a candidate if a corner is nearer to the iso-value than this share of the change along an edge of a block.
A plane through a block of a linear density lies within 0.5 of such a change from one of its corners; the rest is margin
for curved densities."""

Density = Callable[[Tensor], Tensor]
"""(P,) density of (P, 3) world points."""


@dataclass(frozen=True)
class IsosurfaceConfig:
    """How finely, and at which value, a density becomes a mesh."""

    resolution: int = 128
    """Samples along each side of the box. Thinner parts than 2 / (resolution - 1) are lost."""
    iso: float = 10.0
    """Inside is density > iso, in the units of the density: activated or raw, as the caller's function returns it."""
    block: int = 4
    """Cells along a side of a block. Parts that are smaller than a block and leave no trace on its corners are missed;
    small blocks cost more coarse samples."""
    slope: float | None = None
    """How much the density changes along a world unit at most (a Lipschitz constant), where one is known: then the
    surface is that of dense evaluation, however small its parts. None judges by how the coarse samples change."""
    dense: bool = False
    """Evaluate every sample. Slower; finds parts of any size."""
    chunk: int = 2**17
    """Points in one call of the density: bounds its memory."""

    def __post_init__(self) -> None:
        if self.resolution < 2 or self.block < 1 or self.chunk < 1:
            raise ValueError(f"resolution {self.resolution} >= 2, block {self.block} >= 1, chunk {self.chunk} >= 1")


@dataclass
class BlockSamples:
    """The array, and which of its blocks are active.

    Attributes:
        resolution: samples of the box along a side; they have the indices 1..resolution of the array.
        block: cells along a side of a block.
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
    iso: float
    device: torch.device
    values: Tensor = field(init=False)
    in_box: Tensor = field(init=False)
    active: Tensor = field(init=False)
    evaluated: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self.blocks = -(-(self.resolution + 1) // self.block)
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
        wanted = torch.zeros_like(self._known)
        wanted[flat] = True
        return (wanted & ~self._known).nonzero().flatten()

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
            x, y, z = corner & 1, corner >> 1 & 1, corner >> 2 & 1
            case |= inside[:, z : z + n, y : y + n, x : x + n] << corner
        block, z, y, x = ((case > 0) & (case < 255)).nonzero().unbind(dim=1)
        # In the array's order, the mesh does not depend on the size of the blocks.
        first, order = (self._first_sample(blocks)[block] + (z * self.side + y) * self.side + x).sort()
        return first, case[block, z, y, x].long()[order]


def sample_blocks(density: Density, config: IsosurfaceConfig, progress: Progress, device: torch.device) -> BlockSamples:
    """Evaluate `density` in every block that its surface can cross (all of them where `config.dense`).

    The arguments are those of `isosurface.extract`. Each sample is evaluated at most once.
    """
    samples = BlockSamples(config.resolution, config.block, config.iso, device)
    evaluate = _Evaluator(density, config.chunk, samples, progress)
    if config.dense:
        samples.active[:] = True
        evaluate(samples.in_box.nonzero().flatten())
        return samples
    new = _coarse_blocks(samples, evaluate, config.slope)
    while new.any():
        samples.active |= new
        blocks = new.flatten().nonzero().flatten()
        evaluate(samples.unknown(samples.samples_of(blocks).flatten()))
        new = _neighbours_crossed(samples, blocks) & ~samples.active
    return samples


class _Evaluator:
    """Asks the density in chunks and reports progress: the share of what is likely to be needed, which never falls."""

    def __init__(self, density: Density, chunk: int, samples: BlockSamples, progress: Progress) -> None:
        self.density, self.chunk, self.samples, self.progress = density, chunk, samples, progress
        # The blocks along the sides of a cube as large as the box: an object rarely has more surface than that.
        self.likely = min(6 * samples.block * samples.resolution**2, samples.resolution**3)
        self.share = 0.0

    def __call__(self, flat: Tensor) -> None:
        total = max(self.samples.evaluated + len(flat), self.likely)
        for part in flat.split(self.chunk) if len(flat) else ():  # A split of nothing is one empty part.
            self.share = max(self.share, self.samples.evaluated / total)
            self.progress(self.share, "Sampling the density")
            values = self.density(self.samples.points(part))
            if values.shape != part.shape:
                raise ValueError(f"the density of ({len(part)}, 3) points has shape {tuple(values.shape)}")
            self.samples.store(part, values.float())


def _coarse_blocks(samples: BlockSamples, evaluate: _Evaluator, slope: float | None) -> Tensor:
    """Blocks (blocks, blocks, blocks) that the samples at their corners make candidates.

    These are the blocks whose corners lie on both sides, and blocks whose corners come near to the iso-value, compared
    with how fast the density changes around there, or with how fast it changes at most (`slope`): they may hold a thin
    or small part that lies between the corners.
    """
    corner = torch.arange(samples.blocks + 1, device=samples.device) * samples.block
    line = corner.clamp(1, samples.resolution)  # The outermost corners lie beyond the box: ask at its boundary.
    flat = ((line[:, None, None] * samples.side + line[:, None]) * samples.side + line).flatten()
    evaluate(samples.unknown(flat))

    values = samples.values[flat].reshape((samples.blocks + 1,) * 3)
    beyond = (corner < 1) | (corner > samples.resolution)
    empty = beyond[:, None, None] | beyond[:, None] | beyond
    inside = ((values > samples.iso) & ~empty).float()
    straddles = _pool(inside, 2, 0) - -_pool(-inside, 2, 0) > 0

    if slope is not None:
        # No sample of a block is farther from the nearest of its corners than half of the block's diagonal.
        reach = slope * 3.0**0.5 / 2.0 * samples.block * 2.0 / (samples.resolution - 1)
        return straddles | ~(-_pool(-(values - samples.iso).abs(), 2, 0) > reach)  # NaN may be anything.
    level = torch.nan_to_num(values - samples.iso, nan=-1e30, posinf=1e30, neginf=-1e30).clamp(-1e30, 1e30)
    change = torch.zeros_like(level)
    for axis in range(3):
        step = level.diff(dim=axis).abs()
        before, after = [0] * 6, [0] * 6
        before[5 - 2 * axis - 1], after[5 - 2 * axis] = 1, 1
        change = torch.maximum(change, torch.maximum(F.pad(step, before), F.pad(step, after)))
    near = -_pool(-level.abs(), 2, 0) < NEARNESS * _pool(change, 2, 0)
    return straddles | near


def _pool(grid: Tensor, size: int, padding: int) -> Tensor:
    return F.max_pool3d(grid[None, None], size, stride=1, padding=padding)[0, 0]


def _neighbours_crossed(samples: BlockSamples, blocks: Tensor) -> Tensor:
    """Blocks (blocks, blocks, blocks) that share a face, crossed by the surface, with one of (A,) flat blocks."""
    inside = samples.inside(blocks)
    found = torch.zeros(samples.blocks**3, dtype=torch.bool, device=samples.device)
    for axis in range(3):  # 0 is z: the order of the array.
        stride = samples.blocks ** (2 - axis)
        place = blocks // stride % samples.blocks
        for end, step in ((0, -1), (samples.block, 1)):
            plane = inside.select(axis + 1, end).flatten(1)
            crossed = plane.any(dim=1) & ~plane.all(dim=1) & (place + step >= 0) & (place + step < samples.blocks)
            found[blocks[crossed] + step * stride] = True
    return found.reshape(samples.active.shape)
