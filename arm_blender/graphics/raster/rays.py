"""Where short rays hit a surface of many small triangles, in plain torch: a grid of cells says which ones to try."""

import torch
from torch import Tensor

from ..ragged import enumerate_items, runs

CHUNK = 1 << 18
"""Pairs of a ray and a triangle tested at once: about 40 MB of work space."""

FEW = 32 * CHUNK
"""Pairs that are all tested: entering a large mesh in cells for a handful of rays would take longer."""

MISS = -1


@torch.no_grad()
def nearest_hits(
    origins: Tensor, directions: Tensor, vertices: Tensor, faces: Tensor, reach: float
) -> tuple[Tensor, Tensor]:
    """The triangle that each line meets closest to its origin, before or behind it, among those that face its way.

    Args:
        origins: (P, 3) world.
        directions: (P, 3) unit. A triangle counts whose normal goes along with it.
        vertices: (N, 3) world.
        faces: (F, 3) int64; small against the whole, for a large one is entered in many cells.
        reach: how far from the origin to look on either side, world units.
    Returns:
        (P,) int64 face, `MISS` where there is none; (P, 3) barycentric coordinates on it.
    Raises:
        ValueError: `reach` is not positive.
    """
    if not reach > 0.0:
        raise ValueError(f"reach must be positive, got {reach}")
    hit = torch.full((len(origins),), MISS, dtype=torch.int64, device=origins.device)
    where = origins.new_zeros(len(origins), 3)
    if not len(origins) or not len(faces):
        return hit, where
    first, count, table = _enter(origins, directions, vertices, faces, reach)
    triangle = vertices[faces].reshape(-1, 9)
    nearest = torch.full((len(origins),), reach, dtype=origins.dtype, device=origins.device)
    for rays in runs(count, CHUNK):
        owner, number = enumerate_items(count[rays])
        ray = rays[owner]
        face = table[first[ray] + number]
        distance, barycentric = _cross(origins[ray], directions[ray], triangle[face])
        _keep_nearest(nearest, hit, where, ray, face, distance, barycentric)
    return hit, where


def _enter(
    origins: Tensor, directions: Tensor, vertices: Tensor, faces: Tensor, reach: float
) -> tuple[Tensor, Tensor, Tensor]:
    """For each ray, where its list of triangles begins in a table, and how long it is; and the table.

    The triangles are entered in every cell that they come within `reach` of; a ray reads the cell of its origin.
    """
    if len(origins) * len(faces) <= FEW:
        every = torch.arange(len(faces), device=faces.device)
        zero = torch.zeros(len(origins), dtype=torch.int64, device=faces.device)
        return zero, zero + len(faces), every
    corners = vertices[faces]
    low, high = corners.amin(dim=1), corners.amax(dim=1)
    cell = float((high - low).amax(dim=1).median().clamp(min=reach))
    start = origins.amin(dim=0)
    shape = ((origins.amax(dim=0) - start) / cell).long() + 1
    begin = ((low - reach - start) / cell).floor().long().clamp(min=0)
    end = torch.minimum(((high + reach - start) / cell).floor().long(), shape - 1)
    sides = (end - begin + 1).clamp(min=0)
    owner, number = enumerate_items(sides.prod(dim=1))
    _, height, depth = sides[owner].unbind(dim=1)
    z, rest = number % depth, torch.div(number, depth, rounding_mode="floor")
    y, x = rest % height, torch.div(rest, height, rounding_mode="floor")
    entered = _key(begin[owner] + torch.stack([x, y, z], dim=1), shape)
    asked = _key(((origins - start) / cell).long(), shape)
    # Only cells that some ray reads: with them the table of a large mesh stays small.
    read, place = torch.unique(asked, return_inverse=True)
    slot = torch.searchsorted(read, entered).clamp(max=len(read) - 1)
    wanted = read[slot] == entered
    slot, order = torch.sort(slot[wanted], stable=True)
    length = torch.bincount(slot, minlength=len(read))
    return (length.cumsum(dim=0) - length)[place], length[place], owner[wanted][order]


def _key(cell: Tensor, shape: Tensor) -> Tensor:
    """(P,) one number for each cell (P, 3)."""
    return (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]


def _cross(origins: Tensor, directions: Tensor, triangles: Tensor) -> tuple[Tensor, Tensor]:
    """(P,) signed distances, infinite where a line passes by or the triangle looks away; (P, 3) barycentric.

    Möller and Trumbore, "Fast, minimum storage ray/triangle intersection" (1997).
    """
    a = triangles[:, :3]
    first, second = triangles[:, 3:6] - a, triangles[:, 6:] - a
    slant = torch.linalg.cross(directions, second, dim=1)
    # Negative where the normal goes along with the line.
    determinant = (first * slant).sum(dim=1)
    facing = determinant < 0.0
    inverse = torch.where(facing, determinant, -1.0).reciprocal()
    offset = origins - a
    u = (offset * slant).sum(dim=1) * inverse
    turned = torch.linalg.cross(offset, first, dim=1)
    v = (directions * turned).sum(dim=1) * inverse
    distance = (second * turned).sum(dim=1) * inverse
    slack = 1e-5  # A line through an edge must not pass between its two triangles.
    inside = facing & (u >= -slack) & (v >= -slack) & (u + v <= 1.0 + slack)
    barycentric = torch.stack([1.0 - u - v, u, v], dim=1).clamp(min=0.0)
    return torch.where(inside, distance, torch.inf), barycentric


def _keep_nearest(
    nearest: Tensor, hit: Tensor, where: Tensor, ray: Tensor, face: Tensor, distance: Tensor, barycentric: Tensor
) -> None:
    """Enter candidates (P,) that are nearer than what the rays have; all of a ray's come at once."""
    chosen = (distance.abs() <= nearest[ray]).nonzero()[:, 0]
    ray, away = ray[chosen], distance[chosen].abs()
    nearest.scatter_reduce_(0, ray, away, "amin")
    best = away == nearest[ray]
    ray, chosen = ray[best], chosen[best]
    hit[ray] = face[chosen]
    where[ray] = barycentric[chosen] / barycentric[chosen].sum(dim=1, keepdim=True)
