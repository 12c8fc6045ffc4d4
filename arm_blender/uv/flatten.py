"""Charts laid flat, as rigid as possible.

Liu et al., "A local/global approach to mesh parameterization" (SGP 2008): each face wants to be rotated only, and edges
are fitted to what their faces want, over and over. The start is the projection along the chart's mean normal.
"""

import time
import warnings

import torch
from torch import Tensor
from torch.nn import functional as F

from ..graphics.connectivity import manifold_pairs
from ..graphics.meshes import face_areas, face_normals
from ..progress import Progress, silent
from .charts import connected, projection_charts, smooth_charts
from .overlaps import layers

ATTEMPTS = 3
"""At laying a region flat, before it is projected face by face."""

ROUNDS, STEPS = 6, 25
"""Local/global rounds, and steps of conjugate gradients in each; stretch is within 0.01 of that of 15 rounds."""

COTANGENTS = (0.05, 20.0)
"""Range of the edges' weights. Below, slivers would pull the wrong way; above, they would outweigh all others."""

ANCHOR = 1e-4
"""Share by which each vertex holds on to its last place: without it charts could drift."""


def flat_charts(
    vertices: Tensor, faces: Tensor, deadline: float, progress: Progress = silent, attempts: int = ATTEMPTS
) -> tuple[Tensor, Tensor]:
    """Charts of a mesh, laid flat, in which no two faces overlap and none is turned over.

    Args:
        vertices: (N, 3) finite. faces: (F, 3) int64.
        deadline: on the monotonic clock; after it charts are left as stretched as they are.
        progress: called once a round; what it raises passes through.
        attempts: at laying down what fails; what still fails is projected.
    Returns:
        (F,) int64 chart of each face, 0, 1, ...; (F, 3, 2) world units: corners in the plane of the chart, right-handed
        seen from the outside.
    """
    if not attempts:
        return projection_charts(vertices, faces)
    chart = smooth_charts(vertices, faces)
    plane, depth = _projected(vertices, faces, chart)
    count = int(chart.max()) + 1
    corner, index = torch.unique(faces * count + chart[:, None], return_inverse=True)
    start = plane.new_zeros(len(corner), 2)
    start[index.flatten()] = plane.reshape(-1, 2)
    plane = _rigid(vertices, faces, index, start, deadline, progress)[index]
    failed = _turned_over(vertices, faces, plane) | (layers(plane, depth, chart) > 0)
    if not bool(failed.any()):
        return chart, plane
    # Cut out with what is around it: single faces would make slivers.
    touched = torch.zeros(len(vertices), dtype=torch.bool, device=faces.device)
    touched[faces[failed].flatten()] = True
    failed = touched[faces].any(dim=1)
    again, plane[failed] = flat_charts(vertices, faces[failed], deadline, attempts=attempts - 1)
    group = chart.masked_scatter(failed, count + again)
    return connected(manifold_pairs(faces) // 3, group, len(faces)), plane


def _turned_over(vertices: Tensor, faces: Tensor, plane: Tensor) -> Tensor:
    """(F,) bool: faces with an area that `plane` shows from behind, or from the side."""
    turned = _cross(plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0])
    area = face_areas(vertices, faces)
    return (turned < 0.0) | ((turned == 0.0) & (area > 1e-6 * area.mean()))


def _projected(vertices: Tensor, faces: Tensor, chart: Tensor) -> tuple[Tensor, Tensor]:
    """(F, 3, 2) corners along the mean normal of their chart, and (F,) heights of the faces above that plane."""
    weighted = face_normals(vertices, faces) * face_areas(vertices, faces)[:, None]
    normal = F.normalize(weighted.new_zeros(int(chart.max()) + 1, 3).index_add_(0, chart, weighted), dim=1)
    x, y = normal.new_tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    aside = torch.where(normal[:, :1].abs() < 0.9, x, y)
    right = F.normalize(torch.linalg.cross(aside, normal), dim=1)
    up = torch.linalg.cross(normal, right)
    corners = vertices[faces]
    plane = torch.stack([(corners * axis[chart][:, None]).sum(dim=-1) for axis in (right, up)], dim=-1)
    return plane, (corners.mean(dim=1) * normal[chart]).sum(dim=1)


def _rigid(
    vertices: Tensor, faces: Tensor, index: Tensor, start: Tensor, deadline: float, progress: Progress
) -> Tensor:
    """(M, 2) places in the plane at which the faces are stretched least.

    Args:
        index: (F, 3) the faces' corners among the M places. start: (M, 2).
    """
    own = _isometric(vertices.double()[faces])
    edge = own - own.roll(-1, dims=1)  # (F, 3, 2): from the next corner to this.
    weight = _cotangents(own)
    tail, head, flat_weight = index.flatten(), index.roll(-1, dims=1).flatten(), weight.flatten()
    places = len(start)
    diagonal = flat_weight.new_zeros(places).index_add_(0, tail, flat_weight).index_add_(0, head, flat_weight)
    entries = torch.cat([torch.stack([tail, head]), torch.stack([head, tail])], dim=1)
    with warnings.catch_warnings():  # Sparse tensors say of themselves that they are new.
        warnings.simplefilter("ignore", UserWarning)
        adjacency = torch.sparse_coo_tensor(
            entries, flat_weight.repeat(2), (places, places), check_invariants=False
        ).to_sparse_csr()
    uv = start.double()
    for number in range(ROUNDS):
        if time.monotonic() > deadline:
            break
        progress(number / ROUNDS, "Flattening charts")
        shown = uv[index] - uv[index.roll(-1, dims=1)]
        moment = (weight[..., None] * shown).mT @ edge
        cosine = moment[:, 0, 0] + moment[:, 1, 1]
        sine = moment[:, 1, 0] - moment[:, 0, 1]
        length = torch.hypot(cosine, sine).clamp(min=1e-20)
        cosine, sine = (cosine / length)[:, None], (sine / length)[:, None]
        x, y = edge.unbind(dim=-1)
        wanted = torch.stack([cosine * x - sine * y, sine * x + cosine * y], dim=-1) * weight[..., None]
        wanted = wanted.reshape(-1, 2)
        target = torch.zeros_like(uv).index_add_(0, tail, wanted).index_add_(0, head, -wanted)
        target += ANCHOR * diagonal[:, None] * uv
        uv = _conjugate_gradients(adjacency, diagonal * (1.0 + ANCHOR) + 1e-12, target, uv)
    return uv.to(start.dtype)


def _conjugate_gradients(adjacency: Tensor, diagonal: Tensor, target: Tensor, start: Tensor) -> Tensor:
    """Some steps towards x with (diagonal - adjacency) x = target, both columns at once; Jacobi-preconditioned."""
    diagonal = diagonal[:, None]
    x = start
    residual = target - (diagonal * x - adjacency @ x)
    direction = residual / diagonal
    energy = (residual * direction).sum(dim=0)
    for _ in range(STEPS):
        image = diagonal * direction - adjacency @ direction
        step = energy / (direction * image).sum(dim=0).clamp(min=1e-30)
        x = x + step * direction
        residual = residual - step * image
        conditioned = residual / diagonal
        last, energy = energy, (residual * conditioned).sum(dim=0)
        direction = conditioned + energy / last.clamp(min=1e-30) * direction
    return x


def _isometric(corners: Tensor) -> Tensor:
    """(F, 3, 2): each triangle (F, 3, 3) in a plane of its own, unstretched, counter-clockwise."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    base = first.norm(dim=1)
    along = (first * second).sum(dim=1) / base.clamp(min=1e-30)
    height = (second.square().sum(dim=1) - along.square()).clamp(min=0.0).sqrt()
    zero = torch.zeros_like(base)
    return torch.stack([zero, zero, base, zero, along, height], dim=1).view(-1, 3, 2)


def _cotangents(own: Tensor) -> Tensor:
    """(F, 3) cotangent of the angle opposite of each edge, corner k to k + 1, of triangles (F, 3, 2)."""
    opposite = own.roll(-2, dims=1)
    a, b = own - opposite, own.roll(-1, dims=1) - opposite
    return ((a * b).sum(dim=-1) / _cross(a, b).abs().clamp(min=1e-30)).clamp(*COTANGENTS)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
