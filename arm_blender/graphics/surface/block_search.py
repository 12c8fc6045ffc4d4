"""Where an iso-surface can be: cubes of the grid's cells, halved as long as the surface may pass through them.

A cube is looked at on its corners, its middle, and the middles of its edges and faces; each of its eight halves in turn
stays in the search if its own corners lie on both sides of the iso-value, or come near to it. What is left in the end
are blocks, which are sampled as a whole, and wherever the surface leaves one the next is added. What the density does
between samples is not known: a part that leaves no trace on any of them is missed.
"""

import torch
from torch import Tensor

from ...progress import Progress
from .sample_grid import BlockSamples, Density, IsosurfaceConfig

NEARNESS = 0.75
"""A half stays if a corner is nearer to the iso-value than this share of the largest change between two neighbouring
samples of its cube. A plane through a half of a linear density lies within 0.5 of such a change from one of its
corners; the rest is margin for curved densities."""

CUBES_AT_ONCE = 2**16
"""Cubes whose samples are compared in one go: bounds the memory."""


def sample_blocks(density: Density, config: IsosurfaceConfig, progress: Progress, device: torch.device) -> BlockSamples:
    """Evaluate `density` in every block that its surface can cross (all of them where `config.dense`).

    The arguments are those of `isosurface.extract`. Each sample is evaluated at most once.
    """
    cube = 1 if config.dense else 2**config.search_halvings
    samples = BlockSamples(config.resolution, config.block, cube, config.iso, device)
    evaluate = _Evaluator(density, config.chunk, samples, progress)
    if config.dense:
        samples.active[:] = True
        evaluate(samples.in_box.nonzero().flatten())
        return samples
    new = _candidates(samples, evaluate, config.slope)
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
        # Two layers on each side of a cube as large as the box: an object rarely has more surface than that.
        self.likely = min(12 * samples.resolution**2, samples.resolution**3)
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


def _candidates(samples: BlockSamples, evaluate: _Evaluator, slope: float | None) -> Tensor:
    """(blocks, blocks, blocks) bool, z first: the blocks that the surface may cross, as far as samples tell."""
    stride = samples.block * samples.cube
    line = torch.arange(0, samples.side - 1, stride, device=samples.device)
    cubes = torch.cartesian_prod(line, line, line)
    while stride > samples.block:
        stride //= 2
        parts = cubes.split(CUBES_AT_ONCE)
        evaluate(torch.cat([samples.unknown(_lattice(samples, part, stride)[0].flatten()) for part in parts]).unique())
        cubes = torch.cat([_crossed_halves(samples, part, stride, slope) for part in parts])
    found = torch.zeros_like(samples.active)
    x, y, z = (cubes // samples.block).unbind(dim=1)
    found[z, y, x] = True
    return found


def _lattice(samples: BlockSamples, cubes: Tensor, stride: int) -> tuple[Tensor, Tensor]:
    """(A, 3, 3, 3) samples, x first, `stride` apart, that cubes with (A, 3) first corners are looked at on; which of
    them lie beyond the box, and stand for the nearest one of its boundary."""
    line = torch.arange(3, device=samples.device) * stride
    place = cubes[:, None] + line[:, None]  # (A, 3, 3): along each axis.
    beyond = (place < 1) | (place > samples.resolution)
    x, y, z = place.clamp(1, samples.resolution).unbind(dim=2)
    flat = (z[:, None, None, :] * samples.side + y[:, None, :, None]) * samples.side + x[:, :, None, None]
    x, y, z = beyond.unbind(dim=2)
    return flat, z[:, None, None, :] | y[:, None, :, None] | x[:, :, None, None]


def _crossed_halves(samples: BlockSamples, cubes: Tensor, stride: int, slope: float | None) -> Tensor:
    """(B, 3) first corners of those halves, `stride` cells wide, of cubes (A, 3) that the surface may cross."""
    flat, beyond = _lattice(samples, cubes, stride)
    values = samples.values[flat]
    inside = (values > samples.iso) & ~beyond
    straddles = (_over_corners(inside.float()) - -_over_corners(-inside.float())) > 0
    if slope is not None:
        # No sample of a half is farther from the nearest of its corners than half of its diagonal.
        reach = slope * 3.0**0.5 / 2.0 * stride * 2.0 / (samples.resolution - 1)
        near = ~(-_over_corners(-(values - samples.iso).abs()) > reach)  # NaN may be anything.
    else:
        level = torch.nan_to_num(values - samples.iso, nan=-1e30, posinf=1e30, neginf=-1e30).clamp(-1e30, 1e30)
        change = torch.stack([level.diff(dim=axis).abs().flatten(1).amax(dim=1) for axis in (1, 2, 3)]).amax(dim=0)
        near = -_over_corners(-level.abs()) < NEARNESS * change[:, None, None, None]
    cube, *half = (straddles | near).nonzero().unbind(dim=1)
    return cubes[cube] + torch.stack(half, dim=1) * stride


def _over_corners(lattice: Tensor) -> Tensor:
    """(A, 2, 2, 2): the largest of (A, 3, 3, 3) values over the corners of each half."""
    for axis in (1, 2, 3):
        lattice = torch.maximum(lattice.narrow(axis, 0, 2), lattice.narrow(axis, 1, 2))
    return lattice


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
