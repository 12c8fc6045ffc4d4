"""Objects that are their own mirror image: what one side shows is known of the other.

Most made things are, about an upright plane. It is used where mesh and masks both say so, and where the masks go on
saying so afterwards: an arm that one side lacks must not be cut off, nor a second one grow.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from ..graphics.cameras import Camera
from ..graphics.meshes import sample_surface
from ..graphics.raster.rasterize import rasterize_views
from ..graphics.surface.sample_grid import Density
from ..graphics.visual_hull import Outlines, signed_silhouette_distance
from ..structures import TriangleMesh, ViewSet, stack_cameras

OFFSETS = (-0.02, 0.0, 0.02)
"""World units from the origin at which a plane is looked for: views are centred on their object."""

POINTS = 600
"""Of a mesh whose mirror images are compared with it."""

UNLIKE = 0.045
"""World units that a mesh may lie from its mirror image in the mean; the networks' errors are not symmetric."""

OVERLAP_LOST = 0.055
"""Of the overlap with the masks, how much less that with the mirrored ones may be."""

SIDE = 160
"""Pixels of the longer side of masks that are compared."""

OVERLAP_KEPT = 0.004
"""Of any view's overlap, how much may be lost by what symmetry makes of the mesh: less than a finger."""

SPARED = 0.012
"""World units outside of the mirrored outlines from where on nothing is: a plane is found to about as much."""

STEEPNESS = 60.0
"""Logits for each world unit by which a point lies outside of the mirrored outlines."""


@dataclass(frozen=True)
class MirrorPlane:
    """The upright plane where the coordinate `axis` (0 or 1) is `at`."""

    axis: int
    at: float

    def mirrored(self, points: Tensor) -> Tensor:
        """(..., 3) points on the other side."""
        other = points.clone()
        other[..., self.axis] = 2.0 * self.at - other[..., self.axis]
        return other

    def views(self, views: ViewSet) -> ViewSet:
        """What the views would show of the mirrored object: pictures turned over, cameras on the other side."""
        width = views.images.shape[-1]
        known = None
        if views.known is not None:
            known = tuple((width - right, top, width - left, bottom) for left, top, right, bottom in views.known)
        cameras = tuple(self._camera(camera) for camera in views.cameras)
        return replace(views, images=views.images.flip(-1), cameras=cameras, known=known)

    def _camera(self, camera: Camera) -> Camera:
        mirror = torch.eye(4).to(camera.c2w)
        mirror[self.axis, self.axis], mirror[self.axis, 3] = -1.0, 2.0 * self.at
        # Mirrored twice, in the world and in the picture, a camera is a camera again.
        c2w, K = mirror @ camera.c2w @ torch.diag(camera.c2w.new_tensor([-1.0, 1.0, 1.0, 1.0])), camera.K.clone()
        K[0, 2] = camera.width - K[0, 2]
        return replace(camera, c2w=c2w, K=K)


def mirror_planes(mesh: TriangleMesh, views: ViewSet) -> list[MirrorPlane]:
    """The planes about which `mesh` and the masks of normalised `views` are symmetric; none, one or two."""
    own = float(overlaps(mesh, views).mean())
    found = []
    for axis in (0, 1):
        unlike, plane = min(
            ((_unlike(mesh, plane), plane) for plane in (MirrorPlane(axis, at) for at in OFFSETS)),
            key=lambda pair: pair[0],
        )
        if unlike < UNLIKE and float(overlaps(mesh, plane.views(views)).mean()) > own - OVERLAP_LOST:
            found.append(plane)
    return found


def _unlike(mesh: TriangleMesh, plane: MirrorPlane) -> float:
    """How far `mesh` lies from its mirror image in the mean, world units."""
    points, _, _ = sample_surface(mesh.vertices, mesh.faces, POINTS, torch.Generator().manual_seed(0))
    return float(torch.cdist(plane.mirrored(points), mesh.vertices).amin(dim=1).mean())


def overlaps(mesh: TriangleMesh, views: ViewSet) -> Tensor:
    """(V,) intersection over union of what each view's camera sees of `mesh` with its mask, where the view knows."""
    height, width = views.images.shape[2:]
    scale = SIDE / max(height, width)
    size = max(1, round(height * scale)), max(1, round(width * scale))
    seen = rasterize_views(mesh.vertices, mesh.faces, [c.resized(size[1], size[0]) for c in views.cameras]).mask
    masks = F.interpolate(views.images[:, 3:], size=size, mode="area")[:, 0] > 0.5
    known = torch.zeros_like(views.images[:, 3:])
    for index, (left, top, right, bottom) in enumerate(views.rectangles):
        known[index, :, top:bottom, left:right] = 1.0
    told = F.interpolate(known, size=size, mode="area")[:, 0] > 0.999
    both, either = (seen & masks & told).sum(dim=(1, 2)), ((seen | masks) & told).sum(dim=(1, 2))
    return both / either.clamp(min=1)


def symmetric(field: Density, views: ViewSet, planes: Sequence[MirrorPlane]) -> Density:
    """The mean of a density and its mirror images, and nothing outside of the mirrored outlines."""
    outlines = [_outlines(plane.views(views)) for plane in planes]

    def value(points: Tensor) -> Tensor:
        total = torch.stack([field(points), *(field(plane.mirrored(points)) for plane in planes)]).mean(dim=0)
        for outline in outlines:
            total = torch.minimum(total, STEEPNESS * (outline.hull_distance(points[None])[0] + SPARED))
        return total

    return value


def _outlines(views: ViewSet) -> Outlines:
    alpha = views.images[:, 3]
    c2w, K = stack_cameras(views.cameras)
    return Outlines(torch.stack([alpha, signed_silhouette_distance(alpha)], dim=1)[None], c2w[None], K[None])


def made_symmetric(
    mesh: TriangleMesh, views: ViewSet, surface: Callable[[Sequence[MirrorPlane]], TriangleMesh]
) -> tuple[TriangleMesh, list[MirrorPlane]]:
    """The mesh that is its own mirror image where mesh and masks allow it, else `mesh` itself; and about which planes.

    Args:
        surface: the mesh of `symmetric` about some planes, made as `mesh` was.
    """
    planes = mirror_planes(mesh, views)
    before = overlaps(mesh, views)
    while planes:
        even = surface(planes)
        if bool((overlaps(even, views) >= before - OVERLAP_KEPT).all()):
            return even, planes
        planes = planes[:-1]
    return mesh, []
