"""From raw marching cubes to a mesh worth unwrapping: cleaned, its floaters dropped, and reduced to a face budget.

xatlas takes seconds for ten thousand clean faces and minutes for a hundred thousand or for tangled ones.
"""

import logging

import fast_simplification
import numpy as np
import torch
from torch import Tensor

from ..errors import EmptyMeshError
from ..graphics.connectivity import cut_nonmanifold, face_components, manifold_pairs
from ..graphics.meshes import face_areas
from ..structures import TriangleMesh

logger = logging.getLogger(__name__)

THRIFT = (3.0, 5.0, 7.0)
"""How fast the quadric error that a collapse may cost grows from pass to pass, in the order tried. 3 leaves 0.6 times
the error of 7 and no slivers, at the same speed, but cannot always reach the budget."""


def clean(mesh: TriangleMesh, min_part: float = 0.01) -> TriangleMesh:
    """The mesh without what no view can show and what the unwrapping stumbles over.

    Removed are faces that are not finite, have no area or exist twice; parts whose area is below `min_part` of the
    largest part's; closed parts that bound a hollow, which lie inside another; vertices of no face. Edges of more than
    two faces are cut apart: their vertices are doubled.

    Raises:
        EmptyMeshError: nothing is left.
    """
    vertices, faces = mesh.vertices, mesh.faces
    faces = faces[_sound(vertices, faces)]
    if not len(faces):
        raise EmptyMeshError("the mesh has no face with an area; check the density, or the mesh file")
    keep, dropped = _parts_worth_keeping(vertices, faces, min_part)
    if dropped:
        logger.info("%d floating or hidden parts dropped", dropped)
    return _compact(*cut_nonmanifold(vertices, faces[keep]))


def decimate(mesh: TriangleMesh, faces: int) -> TriangleMesh:
    """The mesh with at most `faces` faces, by collapsing the edges that change the surface least (quadric error).

    A mesh within the budget comes back unchanged. The result is cleaned as by `clean`, with all of its parts.

    Args:
        mesh: welded, as `clean` returns it.
        faces: at least 4.
    """
    if faces < 4:
        raise ValueError(f"a budget of {faces} faces cannot close a surface; give at least 4")
    if len(mesh.faces) <= faces:
        return mesh
    low, high = mesh.vertices.amin(dim=0), mesh.vertices.amax(dim=0)
    # The collapse thresholds are absolute; in the unit box they mean the same for every mesh.
    center, scale = (low + high) / 2, (high - low).max().clamp(min=1e-12) / 2
    points = ((mesh.vertices - center) / scale).cpu().numpy().astype(np.float64)
    triangles = mesh.faces.cpu().numpy().astype(np.int32)
    for thrift in THRIFT:
        reduced_points, reduced = fast_simplification.simplify(points, triangles, target_count=faces, agg=thrift)
        if len(reduced) <= faces:
            break
    else:
        logger.info("%d faces are left of %d: no more edges could be collapsed", len(reduced), len(triangles))
    device = mesh.vertices.device
    vertices = torch.from_numpy(reduced_points).to(device, mesh.vertices.dtype) * scale + center
    reduced_faces = torch.from_numpy(reduced).to(device, torch.int64)
    return clean(TriangleMesh(vertices, reduced_faces[~_flaps(reduced_faces)]), min_part=0.0)


def _sound(vertices: Tensor, faces: Tensor) -> Tensor:
    """(F,) bool: finite, with an area, and the first of its kind."""
    finite = vertices.isfinite().all(dim=1)[faces].all(dim=1)
    sound = finite & (face_areas(vertices, faces) > 0)
    distinct, kind = torch.unique(faces.sort(dim=1).values, dim=0, return_inverse=True)
    number = torch.where(sound, torch.arange(len(faces), device=faces.device), len(faces))
    first = number.new_full((len(distinct),), len(faces)).scatter_reduce(0, kind, number, "amin")
    return sound & (first[kind] == number)


def _flaps(faces: Tensor) -> Tensor:
    """(F,) bool: faces back to back with another, as a collapse leaves them. Without both, the rest stays closed."""
    low_first = faces.argmin(dim=1, keepdim=True)
    turned = faces.gather(1, (low_first + torch.arange(3, device=faces.device)) % 3)
    direction = torch.where(turned[:, 1] < turned[:, 2], 1, -1)
    distinct, kind = torch.unique(faces.sort(dim=1).values, dim=0, return_inverse=True)
    return direction.new_zeros(len(distinct)).index_add_(0, kind, direction)[kind] == 0


def _parts_worth_keeping(vertices: Tensor, faces: Tensor, min_part: float) -> tuple[Tensor, int]:
    """(F,) bool, and how many parts are not kept."""
    part = face_components(faces)
    count = int(part.max()) + 1
    if count == 1:
        return torch.ones(len(faces), dtype=torch.bool, device=faces.device), 0
    zero = torch.zeros(count, dtype=torch.float64, device=faces.device)
    area = zero.index_add(0, part, face_areas(vertices, faces).double())
    a, b, c = vertices[faces].double().unbind(dim=1)
    volume = zero.index_add(0, part, (a * torch.linalg.cross(b, c)).sum(dim=1))
    paired = torch.bincount(part[manifold_pairs(faces).flatten() // 3], minlength=count)
    closed = paired == 3 * torch.bincount(part, minlength=count)
    largest = area.argmax()
    keep = (area >= min_part * area[largest]) & ~(closed & (volume < 0))
    keep[largest] = True
    return keep[part], int((~keep).sum())


def _compact(vertices: Tensor, faces: Tensor) -> TriangleMesh:
    """The mesh without vertices of no face; the others keep their order."""
    used = torch.zeros(len(vertices), dtype=torch.bool, device=vertices.device)
    used[faces.flatten()] = True
    return TriangleMesh(vertices[used], (torch.cumsum(used, dim=0) - 1)[faces])
