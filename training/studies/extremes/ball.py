"""The ball that the measurements on extreme inputs share: its density, and what must hold of its mesh."""

import math

import torch
from torch import Tensor

from arm_blender.structures import TriangleMesh

RADIUS = 0.7
VOLUME = 4.0 / 3.0 * math.pi * RADIUS**3


def ball(points: Tensor, steepness: float, iso: float) -> Tensor:
    """(P,) density at world points (P, 3): `iso` on the surface, with a slope there, or a step from -inf to inf."""
    inside = RADIUS - points.norm(dim=1)
    rise = torch.where(inside > 0.0, torch.inf, -torch.inf) if math.isinf(steepness) else steepness * inside
    return iso + rise


def open_edges(mesh: TriangleMesh) -> int:
    """How many edges do not have as many faces on one side as on the other; 0 of a closed surface."""
    start, end = mesh.faces, mesh.faces.roll(-1, dims=1)
    sign = torch.where(start < end, 1, -1).flatten()
    key = (torch.minimum(start, end) * len(mesh.vertices) + torch.maximum(start, end)).flatten()
    unique, index = key.unique(return_inverse=True)
    return int((torch.zeros(len(unique), dtype=torch.int64).index_add(0, index, sign) != 0).sum())


def volume(mesh: TriangleMesh) -> float:
    """What a closed surface holds, by the divergence theorem; negative where it points inwards."""
    a, b, c = mesh.vertices[mesh.faces].double().unbind(dim=1)
    return float((a * torch.linalg.cross(b, c, dim=1)).sum() / 6.0)
