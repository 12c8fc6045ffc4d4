"""Where a user's mesh has to be for the pictures to show it, and which way up."""

import torch

from ..errors import EmptyMeshError
from ..graphics.borders import scaled
from ..graphics.cameras import Camera, project
from ..graphics.raster.rasterize import rasterize
from ..structures import TriangleMesh, UvMesh, ViewSet
from .scene_frame import SceneFrame

_ROUNDS = 8
"""Each leaves what perspective adds to the outline; the error falls by an order of magnitude a round."""

_FIT_SIDE = 192
"""Pixels of the longer side of the outlines that are compared."""

_BETTER = 0.02
"""Intersection over union by which an outline has to be better before a mesh is turned."""


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


def up_axis(mesh: TriangleMesh | UvMesh, views: ViewSet) -> tuple[str, dict[str, float]]:
    """Which axis of a file that does not say so is up: "y" where the outlines fit better so, else "z".

    Args:
        mesh: as it is in the file, in the frame of the views' cameras but for that.
    Returns:
        The axis, and how well the outlines fit with each (`outline_fit`).
    """
    fits = {"z": outline_fit(mesh, views), "y": outline_fit(mesh.moved(z_up), views)}
    return ("y" if fits["y"] > fits["z"] + _BETTER else "z"), fits


def z_up(points: torch.Tensor) -> torch.Tensor:
    """(..., 3) points of a frame in which Y is up, as in glTF and most OBJ files, in ours: a quarter turn about X."""
    x, y, z = points.unbind(-1)
    return torch.stack([x, -z, y], dim=-1)


@torch.no_grad()
def outline_fit(mesh: TriangleMesh | UvMesh, views: ViewSet) -> float:
    """How well the mesh's outlines are those of the views' masks, in [0, 1]: intersection over union of all pixels."""
    height, width = views.images.shape[2:]
    scale = min(1.0, _FIT_SIDE / max(height, width))
    size = max(1, round(scale * height)), max(1, round(scale * width))
    masks = torch.nn.functional.interpolate(views.images[:, 3:], size, mode="area")[:, 0] > 0.5
    both = either = 0
    for mask, camera, known in zip(masks, views.cameras, views.rectangles, strict=True):
        drawn = rasterize(mesh.vertices, mesh.faces, camera.resized(size[1], size[0])).mask
        left, top, right, bottom = scaled(known, size[1] / width, size[0] / height)
        inside = (slice(top, bottom), slice(left, right))
        both += int((drawn[inside] & mask[inside]).sum())
        either += int((drawn[inside] | mask[inside]).sum())
    return both / max(either, 1)
