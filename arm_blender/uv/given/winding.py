"""A user's mesh whose faces look inwards: seen from behind, it would get the colours of its far side."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ...graphics.cameras import Camera, view_directions
from ...graphics.connectivity import components, manifold_pairs
from ...graphics.meshes import face_normals
from ...graphics.raster.rasterize import rasterize
from ...structures import TriangleMesh, UvMesh

_TURNED = 3.0
"""Times as many pixels as in front, from behind, at which a patch is turned: a fin is seen from both of its sides."""

_SIDE = 256
"""Pixels of the longer side of the pictures that are counted."""


@torch.no_grad()
def facing_out(mesh: TriangleMesh | UvMesh, cameras: Sequence[Camera]) -> tuple[TriangleMesh | UvMesh, float]:
    """The mesh with every patch turned that the cameras see from behind, and hardly from in front.

    A patch is of faces that agree across their edges on which side is out. One that no camera sees stays.

    Args:
        mesh: in the frame of the cameras.
    Returns:
        The mesh, the same where nothing is turned, and the share of faces that were.
    """
    before, behind = _seen(mesh, cameras)
    pairs = manifold_pairs(mesh.faces) // 3
    patch = components(pairs, len(mesh.faces))
    count = int(patch.max()) + 1
    front, back = (before.new_zeros(count).index_add(0, patch, pixels) for pixels in (before, behind))
    turn = (back > _TURNED * front)[patch]
    if not bool(turn.any()):
        return mesh, 0.0
    share = float(turn.float().mean())
    faces = _swapped(mesh.faces, turn)
    if isinstance(mesh, UvMesh):
        return replace(mesh, faces=faces, face_uvs=_swapped(mesh.face_uvs, turn)), share
    return replace(mesh, faces=faces), share


def _seen(mesh: TriangleMesh | UvMesh, cameras: Sequence[Camera]) -> tuple[Tensor, Tensor]:
    """(F,) how many pixels of all cameras see each face from in front, and (F,) from behind."""
    normals, centers = face_normals(mesh.vertices, mesh.faces), mesh.vertices[mesh.faces].mean(dim=1)
    found = normals.new_zeros(2, len(mesh.faces))
    for camera in cameras:
        scale = _SIDE / max(camera.width, camera.height)
        small = camera.resized(max(1, round(scale * camera.width)), max(1, round(scale * camera.height)))
        shown = rasterize(mesh.vertices, mesh.faces, small)
        pixels = torch.bincount(shown.face_id[shown.mask], minlength=len(mesh.faces)).to(normals)
        front = (normals * view_directions(centers, camera)).sum(dim=1) > 0.0
        found += torch.stack([pixels * front, pixels * ~front])
    return found[0], found[1]


def _swapped(corners: Tensor, turn: Tensor) -> Tensor:
    """(F, 3) with the order of the corners reversed where `turn` (F,)."""
    return torch.where(turn[:, None], corners[:, [0, 2, 1]], corners)
