"""Scenes elsewhere: an object outside the box [-1, 1]^3 is brought into it for the networks, and put back at the end.

Nothing but the views' masks and frusta says where an object is. As long as the object can lie inside the box, that is,
the part of the masks' visual hull inside the box still covers every mask, nothing is moved: the usual case is exactly
the identity. Hulls of few views reach far beyond their objects, so the hull's own size is no such test.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import torch
from torch import Tensor

from ..errors import CameraError, InputImageError
from ..graphics.borders import Rectangle, scaled
from ..graphics.cameras import Camera, project
from ..structures import TriangleMesh, UvMesh, ViewSet

Mesh = TypeVar("Mesh", TriangleMesh, UvMesh)

COARSE, _FINE = 64, 192
"""Pixels of the longer side of the masks: to see whether the box will do, and to measure a hull elsewhere. In the usual
rig a coarse pixel is 0.03 world units."""

_RAYS, _STEPS = 512, 80
"""Pixels of a mask that are looked at, and samples of the ray of each inside the box."""

_COVERED = 0.97
"""Of a mask's pixels, how many must be explained from inside the box: noise in a mask moves no scene."""

_SMALLEST = 0.4
"""World units: an object whose hull is smaller than this in every direction gets too few cells of the grid."""

_TARGET = 2.0
"""World units: the longest side of a hull that was brought into the box; the object itself is at most that long."""

_GRID = 48
"""Samples a side of the grid in which a hull elsewhere is measured."""


@dataclass(frozen=True)
class SceneFrame:
    """Where the networks' box lies in the cameras' own frame.

    Attributes:
        center: (3,) the box's centre, in the cameras' frame.
        scale: length in the cameras' frame of one unit of the box.
    """

    center: Tensor
    scale: float

    @property
    def is_identity(self) -> bool:
        return self.scale == 1.0 and not bool(self.center.any())

    def restore(self, points: Tensor) -> Tensor:
        """(..., 3) points of the box in the cameras' frame; the very same where the frame is the identity."""
        return points if self.is_identity else points * self.scale + self.center.to(points)

    def restored(self, mesh: Mesh, length: float | None) -> Mesh:
        """A mesh of the box in the cameras' frame; where a `length` is given, its longest side becomes that long."""
        mesh = mesh.moved(self.restore)
        if length is None:
            return mesh
        scale = length / float((mesh.vertices.amax(dim=0) - mesh.vertices.amin(dim=0)).max())
        return mesh.moved(lambda points: points * scale)

    def boxed(self, points: Tensor) -> Tensor:
        """(..., 3) points of the cameras' frame in the box; undoes `restore`."""
        return points if self.is_identity else (points - self.center.to(points)) / self.scale

    def normalised(self, camera: Camera) -> Camera:
        """`camera` in the frame of the box: moved and scaled, never turned."""
        if self.is_identity:
            return camera
        c2w = camera.c2w.clone()
        c2w[:3, 3] = self.boxed(c2w[:3, 3])
        return replace(camera, c2w=c2w)


IDENTITY = SceneFrame(torch.zeros(3), 1.0)


@torch.no_grad()
def normalise(views: ViewSet) -> tuple[ViewSet, SceneFrame]:
    """Views whose object lies in the box [-1, 1]^3, and the frame that puts a result back.

    Returns:
        `views` itself and the identity where the object can lie inside the box.
    Raises:
        CameraError: the masks do not meet in space, or a single view looks past the box.
        InputImageError: a view shows nothing.
    """
    silhouettes = silhouettes_of(views, COARSE)
    covered, explained = _explained_from_box(silhouettes)
    single = len(silhouettes) == 1
    if covered >= _COVERED and (single or float((explained.amax(dim=0) - explained.amin(dim=0)).max()) >= _SMALLEST):
        return views, IDENTITY
    if single:
        raise CameraError(f"{views.name}: the one view looks past [-1, 1]^3; bring the object there, or add views")
    low, high = _hull_bounds(silhouettes_of(views, _FINE), views.name)
    frame = SceneFrame((low + high) / 2.0, float((high - low).max()) / _TARGET)
    ground = None if views.ground is None else (views.ground - float(frame.center[2])) / frame.scale
    moved = replace(views, cameras=tuple(frame.normalised(camera) for camera in views.cameras), ground=ground)
    return moved, frame


@dataclass(frozen=True)
class Silhouette:
    """A view's mask at a lower resolution, and its camera at that resolution.

    Attributes:
        mask: (h, w) bool: the pixel holds some of the object.
        wide: (h, w) bool: it or a neighbour does.
        camera: on the CPU.
        known: the pixels that the camera took.
    """

    mask: Tensor
    wide: Tensor
    camera: Camera
    known: Rectangle

    def holds(self, points: Tensor) -> Tensor:
        """(P,) bool: in front of the camera and in the wide mask; beyond the picture, where the object is cut off."""
        pixels, depth = project(points, self.camera)
        # Points near the plane of the pinhole land anywhere: the clamp keeps them in the range of integers.
        column, row = pixels.clamp(-1.0, 1e6).floor().long().unbind(-1)
        left, top, right, bottom = self.known
        in_picture = (column >= left) & (row >= top) & (column < right) & (row < bottom)
        nearest = row.clamp(top, bottom - 1) * self.mask.shape[1] + column.clamp(left, right - 1)
        return (depth > 0.0) & torch.where(in_picture, self.wide.flatten()[nearest], self.mask.flatten()[nearest])


def silhouettes_of(views: ViewSet, side: int) -> list[Silhouette]:
    """The views' silhouettes at `side` pixels of the longer side, or at the views' own size where that is less."""
    height, width = views.images.shape[2:]
    cell = max(1.0, max(height, width) / side)
    size = max(1, round(height / cell)), max(1, round(width / cell))
    masks = torch.nn.functional.adaptive_max_pool2d((views.images[:, 3:].cpu() > 0.5).float(), size)
    for index, mask in enumerate(masks):
        if not bool(mask.any()):
            raise InputImageError(f"{views.name}: view {index} shows nothing; give it an alpha, or leave it out")
    wide = torch.nn.functional.max_pool2d(masks, 3, stride=1, padding=1)
    cameras = (camera.to("cpu").resized(size[1], size[0]) for camera in views.cameras)
    known = [scaled(one, size[1] / width, size[0] / height) for one in views.rectangles]
    return [Silhouette(*one) for one in zip(masks[:, 0] > 0.5, wide[:, 0] > 0.5, cameras, known, strict=True)]


def _inside_all(points: Tensor, silhouettes: list[Silhouette]) -> Tensor:
    """(P,) bool: in every silhouette."""
    inside = torch.ones(len(points), dtype=torch.bool)
    for silhouette in silhouettes:
        inside &= silhouette.holds(points)
    return inside


def _explained_from_box(silhouettes: list[Silhouette]) -> tuple[float, Tensor]:
    """How much of each mask the hull inside [-1, 1]^3 covers, the least of all; and (P, 3) points of that hull."""
    least, found = 1.0, [torch.zeros(1, 3)]
    for silhouette in silhouettes:
        points, crosses = points_in_box(silhouette)
        inside = _inside_all(points.view(-1, 3), silhouettes).view(len(points), -1) & crosses[:, None]
        least = min(least, float(inside.any(dim=1).float().mean()))
        found.append(points[inside])
    return least, torch.cat(found)


def points_in_box(silhouette: Silhouette, most: int = _RAYS) -> tuple[Tensor, Tensor]:
    """(R, S, 3) samples, inside [-1, 1]^3, of the rays through R pixels of a mask; and (R,) bool: a ray crosses it.

    R is at most `most`.
    """
    camera = silhouette.camera
    row, column = torch.nonzero(silhouette.mask, as_tuple=True)
    stride = -(-len(row) // most)
    rays = _rays(column[::stride] + 0.5, row[::stride] + 0.5, camera)
    # A mask's pixels reach out of the object by up to one pixel, and so does the box.
    half = 1.0 + min(0.1, float(camera.center.norm() / camera.K[1, 1]))
    limits = torch.tensor([-half, half]).view(2, 1, 1)
    bounds = (limits - camera.center) / torch.where(rays == 0.0, torch.full_like(rays, 1e-12), rays)
    near = bounds.amin(dim=0).amax(dim=-1).clamp(min=0.0)
    far = bounds.amax(dim=0).amin(dim=-1)
    fractions = (torch.arange(_STEPS) + 0.5) / _STEPS
    depths = near[:, None] + (far - near)[:, None] * fractions
    return camera.center + rays[:, None] * depths[..., None], far > near


def _rays(x: Tensor, y: Tensor, camera: Camera) -> Tensor:
    """(P, 3) world directions of the pixel coordinates `x`, `y` (P,); a step of 1 is 1 of depth."""
    local = torch.stack(
        [(x - camera.K[0, 2]) / camera.K[0, 0], (camera.K[1, 2] - y) / camera.K[1, 1], -torch.ones_like(x)], dim=-1
    )
    return local @ camera.c2w[:3, :3].T


def _hull_bounds(silhouettes: list[Silhouette], name: str) -> tuple[Tensor, Tensor]:
    """(3,) lowest and highest corner of the hull of the masks, wherever it is.

    Raises:
        CameraError: the masks meet nowhere.
    """
    center = _meeting_point(silhouettes)
    reach = 0.0
    for silhouette in silhouettes:
        pixels = torch.nonzero(silhouette.mask)
        span = int((pixels.amax(dim=0) - pixels.amin(dim=0)).max()) + 1
        depth = float(project(center, silhouette.camera)[1])
        reach = max(reach, abs(depth) * span / float(silhouette.camera.K[1, 1]))
    low, high = center - reach, center + reach
    for _ in range(3):  # Each time the grid shrinks onto what it found, with a cell to spare.
        axes = [torch.linspace(float(a), float(b), _GRID) for a, b in zip(low, high, strict=True)]
        points = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).view(-1, 3)
        found = points[_inside_all(points, silhouettes)]
        if len(found) == 0:
            raise CameraError(
                f"{name}: the masks of the views do not meet in space; check the poses (c2w, the camera looks along -Z)"
            )
        cell = (high - low) / (_GRID - 1)
        low, high = found.amin(dim=0) - cell, found.amax(dim=0) + cell
    return low + cell, high - cell


def _meeting_point(silhouettes: list[Silhouette]) -> Tensor:
    """(3,) the point nearest to the rays through the masks' middles, in the sense of least squares."""
    system, right = torch.zeros(3, 3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    for silhouette in silhouettes:
        row, column = torch.nonzero(silhouette.mask).float().mean(dim=0) + 0.5
        ray = torch.nn.functional.normalize(_rays(column, row, silhouette.camera).double(), dim=-1)
        across = torch.eye(3, dtype=torch.float64) - torch.outer(ray, ray)
        system += across
        right += across @ silhouette.camera.center.double()
    # Parallel rays leave the system singular: the least-norm solution then lies near the origin.
    return torch.linalg.lstsq(system, right[:, None], driver="gelsd").solution[:, 0].float()
