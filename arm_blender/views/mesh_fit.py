"""Where a user's mesh has to be for pictures without cameras to show it."""

import torch

from ..errors import EmptyMeshError
from ..graphics.cameras import Camera, project
from ..structures import TriangleMesh, UvMesh, ViewSet
from .scene_frame import SceneFrame

_ROUNDS = 8
"""Each leaves what perspective adds to the outline; the error falls by an order of magnitude a round."""


def fit_to_views(mesh: TriangleMesh | UvMesh, views: ViewSet) -> SceneFrame:
    """The frame whose `restore` brings `mesh` to where its outline fills the masks' bounding boxes; never turned.

    Pictures without cameras come with assumed ones, which say where the object is but not how large the user's is.

    Args:
        mesh: of the same object, upright and with its front at -Y, at any place and of any size.
        views: the frame of their cameras is the one that is restored to.
    Raises:
        EmptyMeshError: the mesh has no extent.
    """
    points = mesh.vertices[mesh.faces.unique()]
    low, high = points.amin(dim=0), points.amax(dim=0)
    middle, extent = (low + high) / 2.0, float((high - low).max())
    if not extent > 0.0:
        raise EmptyMeshError(f"{views.name}: the given mesh is one point; give a mesh with faces")
    points = (points - middle) * (2.0 / extent)  # The assumed cameras look at the origin, and at that size.
    scale, shift = 1.0, torch.zeros(3)
    corners = torch.tensor([0.0, 1.0])[:, None, None]
    boxes = [_box((torch.nonzero(image[3] > 0.5).flip(1) + corners).flatten(0, 1)) for image in views.images]
    for _ in range(_ROUNDS):
        ratios, rows, offsets = [], [], []
        for camera, (target, side) in zip(views.cameras, boxes, strict=True):
            center, size = _box(project(points * scale + shift, camera)[0])
            ratios.append(side / max(size, 1e-6))
            rows.append(camera.c2w[:3, :2].T)
            offsets.append(_in_plane(target - center, shift, camera))
        # A single picture says nothing of the depth: the least motion that fits leaves it as it is.
        shift = shift + torch.linalg.pinv(torch.cat(rows)) @ torch.cat(offsets)
        scale *= float(torch.tensor(ratios).log().mean().exp())
    total = scale * 2.0 / extent
    return SceneFrame(shift - middle * total, total)


def _box(pixels: torch.Tensor) -> tuple[torch.Tensor, float]:
    """Centre (2,) and longer side of the bounding box of (P, 2) pixel coordinates."""
    low, high = pixels.amin(dim=0), pixels.amax(dim=0)
    return (low + high) / 2.0, float((high - low).max())


def _in_plane(pixels: torch.Tensor, point: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(2,) world units to the right and up of the camera that are `pixels` (2,) at the depth of `point` (3,)."""
    depth = float(project(point, camera)[1])
    return torch.stack([pixels[0] * depth / camera.K[0, 0], -pixels[1] * depth / camera.K[1, 1]])
