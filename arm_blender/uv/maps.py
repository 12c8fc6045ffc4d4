"""Finishing an atlas: padding the gaps between charts, filling what no view saw, finding constant maps."""

import torch
from torch import Tensor
from torch.nn import functional

from ..report import Report
from ..structures import TexelMap

FILL_RESOLUTION = 64  # Cells a side of the grid in which seen colours spread to unseen texels.
CONSTANT_TOLERANCE = 0.02
"""A roughness or metallic map that stays this close to one value becomes the value; the eye sees no difference."""

ENOUGH = 1.0  # Seen texels around a point before their mean stands without that of the coarser level.


@torch.no_grad()
def pad(image: Tensor, mask: Tensor) -> Tensor:
    """Give every uncovered texel the value of the nearest covered one, so that filtering finds no gap colour.

    Charts that lie further apart than a filter reaches do not bleed into each other: between them each gap texel
    belongs to the chart nearest to it. Covered texels keep their values.

    Args:
        image: (C, T, T).
        mask: (T, T) bool, covered texels. Where none is covered the image is returned as it is.
    """
    if image.ndim != 3 or image.shape[1:] != mask.shape:
        raise ValueError(f"image (C, T, T) and mask (T, T) expected, got {tuple(image.shape)}, {tuple(mask.shape)}")
    if not mask.any() or mask.all():
        return image.clone()
    return image.flatten(1)[:, _nearest_covered(mask)].view_as(image)


@torch.no_grad()
def diffuse_fill(color: Tensor, known: Tensor, texels: TexelMap) -> Tensor:
    """Colour for texels that no view saw: a smooth blend of the seen ones that are near in space, across charts.

    Seen colours are averaged in the cells of ever coarser grids around the object; an unseen texel reads the finest
    grid that holds enough of them (push-pull in three dimensions).

    Args:
        color: (C, T, T).
        known: (T, T) bool, texels whose colour stands.
        texels: of the atlas.
    Returns:
        (C, T, T): known texels unchanged, the other covered ones filled, 0 where no chart lies. Without a known texel
        the fill is mid grey, linear 0.5.
    """
    known = known & texels.mask
    unknown = texels.mask & ~known
    result = color * known
    if not unknown.any():
        return result
    if not known.any():
        result[:, unknown] = 0.5
        return result
    cell, origin = _grid_of(texels)
    # Cells along (z, y, x), the order of grid_sample; a value and its weight side by side.
    inside = ((texels.position[:, known] - origin) / cell).long().clamp(0, FILL_RESOLUTION - 1)
    index = (inside[2] * FILL_RESOLUTION + inside[1]) * FILL_RESOLUTION + inside[0]
    samples = torch.cat([color[:, known], torch.ones_like(color[:1, known])])
    sums = color.new_zeros(len(samples), FILL_RESOLUTION**3).index_add_(1, index, samples)
    where = (texels.position[:, unknown] - origin) / (cell * FILL_RESOLUTION) * 2.0 - 1.0
    result[:, unknown] = _push_pull(sums.view(1, -1, FILL_RESOLUTION, FILL_RESOLUTION, FILL_RESOLUTION), where.T)
    return result


def constant_value(image: Tensor, mask: Tensor, tolerance: float) -> float | None:
    """The one value of a map, or None where covered texels differ by more than `tolerance` from it.

    Args:
        image: (1, T, T).
        mask: (T, T) bool, the texels that count.
        tolerance: half the range that still counts as one value.
    """
    values = image[0][mask]
    if values.numel() == 0 or not torch.isfinite(values).all():
        return None
    low, high = values.aminmax()
    return float(low + high) / 2.0 if float(high - low) <= 2.0 * tolerance else None


def gloss_maps(glossy: Tensor, mask: Tensor, report: Report) -> tuple[Tensor | float, ...]:
    """Roughness and metallic of `glossy` (2, T, T), padded beyond the mask (T, T), or a value where the map is one."""
    result: list[Tensor | float] = []
    for name, image in zip(("roughness", "metallic"), pad(glossy, mask).split(1), strict=True):
        constant = constant_value(image, mask, CONSTANT_TOLERANCE)
        if constant is not None:
            report.leave_out(f"{name} texture", f"it is {constant:.2f} everywhere")
        result.append(image if constant is None else constant)
    return tuple(result)


def _nearest_covered(mask: Tensor) -> Tensor:
    """(T * T,) flat index of the covered texel nearest to each texel, by jump flooding."""
    height, width = mask.shape
    rows = torch.arange(height, device=mask.device, dtype=torch.float32)[:, None].expand(height, width)
    columns = torch.arange(width, device=mask.device, dtype=torch.float32)[None].expand(height, width)
    # A texel that no seed has reached yet points so far away that any seed is nearer.
    far = torch.full_like(rows, 16.0 * max(height, width))
    seed_row, seed_column = torch.where(mask, rows, far), torch.where(mask, columns, far)
    step = 1 << (max(height, width) - 1).bit_length()
    # The last two steps run twice: jump flooding alone leaves a few texels with the second nearest.
    for jump in [step >> shift for shift in range(1, step.bit_length())] + [2, 1]:
        old_row, old_column = seed_row.clone(), seed_column.clone()
        distance = (old_row - rows) ** 2 + (old_column - columns) ** 2
        for dy, dx in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
            here_y, there_y = _overlap(dy * jump, height)
            here_x, there_x = _overlap(dx * jump, width)
            here, there = (here_y, here_x), (there_y, there_x)
            candidate = (old_row[there] - rows[here]) ** 2 + (old_column[there] - columns[here]) ** 2
            closer = candidate < distance[here]
            distance[here] = torch.where(closer, candidate, distance[here])
            seed_row[here] = torch.where(closer, old_row[there], seed_row[here])
            seed_column[here] = torch.where(closer, old_column[there], seed_column[here])
    return (seed_row.long() * width + seed_column.long()).flatten()


def _overlap(shift: int, size: int) -> tuple[slice, slice]:
    """The indices whose neighbour at `shift` lies inside, and those neighbours."""
    low, high = max(0, -shift), max(0, min(size, size - shift))
    return slice(low, max(low, high)), slice(low + shift, max(low, high) + shift)


def _grid_of(texels: TexelMap) -> tuple[Tensor, Tensor]:
    """Edge of a cell (scalar) and the corner (3, 1) of a cube of cells around the covered texels."""
    points = texels.position[:, texels.mask]
    low, high = points.amin(dim=1), points.amax(dim=1)
    edge = (high - low).amax().clamp(min=1e-6)
    return edge / FILL_RESOLUTION, ((low + high - edge) / 2.0)[:, None]


def _push_pull(sums: Tensor, points: Tensor) -> Tensor:
    """(C, P) means at points (P, 3) in [-1, 1] from sums and, as last channel, counts (1, C + 1, G, G, G)."""
    levels = [sums]
    while levels[-1].shape[-1] > 1:
        levels.append(functional.avg_pool3d(levels[-1], 2) * 8.0)
    mean = points.new_zeros(sums.shape[1] - 1, len(points))
    for level in reversed(levels):
        # Sums and counts are read apart, so that the empty cells beside a surface have no say.
        read = functional.grid_sample(
            level, points[None, None, None], mode="bilinear", padding_mode="border", align_corners=False
        )[0, :, 0, 0]
        trust = (read[-1:] / ENOUGH).clamp(max=1.0)
        mean += trust * (read[:-1] / read[-1:].clamp(min=1e-6) - mean)
    return mean
