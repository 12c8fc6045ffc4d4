"""Where a user's mesh has to be for the pictures to show it, and which way up."""

from collections.abc import Sequence

import torch

from ..errors import EmptyMeshError
from ..graphics.borders import cut_sides, scaled
from ..graphics.cameras import Camera, project
from ..graphics.raster.rasterize import rasterize
from ..structures import TriangleMesh, UvMesh, ViewSet
from .scene_frame import SceneFrame

_ROUNDS = 8
"""Each leaves what perspective adds to the outline; the error falls by an order of magnitude a round."""

_LEAP = 0.7
"""Logarithm of how much larger or smaller a mesh may become in a round."""

_FIT_SIDE = 192
"""Pixels of the longer side of the outlines that are compared."""

_BETTER = 0.02
"""Intersection over union by which an outline has to be better before a mesh is turned."""


def fit_to_views(mesh: TriangleMesh | UvMesh, views: ViewSet) -> SceneFrame:
    """The frame whose `restore` brings `mesh` to where its outline fills the masks' bounding boxes; never turned.

    Pictures without cameras come with assumed ones, which say where the object is but not how large the user's is.
    A side of a box at which the picture's border cuts the object says nothing of where the object ends.

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
    boxes, ways = _shown_boxes(views)
    frames = [_frame_of(points, views.cameras, boxes, ends) for ends in ways]
    frames = [
        SceneFrame(frame.center - middle * frame.scale * 2.0 / extent, frame.scale * 2.0 / extent) for frame in frames
    ]
    return (
        max(frames, key=lambda frame: outline_fit(mesh.moved(frame.restore), views)) if len(frames) > 1 else frames[0]
    )


def _frame_of(points: torch.Tensor, cameras: Sequence[Camera], boxes: torch.Tensor, ends: torch.Tensor) -> SceneFrame:
    """Where points (P, 3) reach the ends of boxes (V, 2, 2) that count: those of which `ends` (V, 2, 2) is true."""
    scale, shift = 1.0, torch.zeros(3)
    for _ in range(_ROUNDS):
        rows, misses = [], []
        for camera, target, told in zip(cameras, boxes, ends, strict=True):
            box = _box(project(points * scale + shift, camera)[0])
            rows.append(_pixels_of_motion(box, shift, camera)[told])
            misses.append((target - box)[told])
        # A single picture says nothing of the depth: the least motion that fits leaves it as it is.
        motion = torch.linalg.pinv(torch.cat(rows)) @ torch.cat(misses)
        shift = shift + motion[:3]
        scale *= float(motion[3].clamp(-_LEAP, _LEAP).exp())
    return SceneFrame(shift, scale)


def _pixels_of_motion(box: torch.Tensor, place: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(2, 2, 4) by how many pixels the ends of a box, as of `_box`, move when the object moves or grows.

    Args:
        place: (3,) the point of the object that stays when it grows.
    Returns:
        For a world unit along x, y and z, and for the logarithm of its scale.
    """
    center, depth = project(place, camera)
    focal = torch.stack([camera.K[0, 0], camera.K[1, 1]])
    across = torch.stack([camera.c2w[:3, 0], -camera.c2w[:3, 1]]) * (focal / depth)[:, None]
    return torch.cat([across.expand(2, 2, 3), (box - center)[..., None]], dim=-1)


def _shown_boxes(views: ViewSet) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """The bounding boxes (V, 2, 2) of the masks, as of `_box`; and ways to tell which of their ends count, (V, 2, 2).

    Where nothing is cut all do. Else: those that the border does not cut; those of pictures that show all of the
    object, for what is beyond one border may be its highest point; all, if there is nothing better.
    """
    corners = torch.tensor([0.0, 1.0])[:, None, None]
    boxes, ends = [], []
    for image, known in zip(views.images, views.rectangles, strict=True):
        boxes.append(_box((torch.nonzero(image[3] > 0.5).flip(1) + corners).flatten(0, 1)))
        ends.append(~torch.tensor(cut_sides(image[3], known)).view(2, 2))
    uncut = torch.stack(ends)
    if bool(uncut.all()):
        return torch.stack(boxes), [uncut]
    ways = [torch.ones_like(uncut)]
    if bool(uncut.all(dim=1).any()):  # Else nothing says how large it is.
        ways.insert(0, uncut)
    if bool((whole := uncut.flatten(1).all(dim=1)).any()):
        ways.insert(0, whole[:, None, None].expand_as(uncut))
    return torch.stack(boxes), ways


def _box(pixels: torch.Tensor) -> torch.Tensor:
    """(2, 2) lowest and highest column and row of (P, 2) pixel coordinates."""
    return torch.stack([pixels.amin(dim=0), pixels.amax(dim=0)])


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
