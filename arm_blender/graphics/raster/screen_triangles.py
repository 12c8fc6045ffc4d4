"""Triangles as cameras project them, cut at the near plane: what the rasteriser draws."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..cameras import Camera, project

NEAR = 1e-2  # World units; what lies closer to the pinhole is cut off.
EDGE_TOLERANCE = 1e-4  # Pixels; keeps float32 rounding from opening cracks along shared edges.


@dataclass(frozen=True)
class ScreenTriangles:
    """Triangles on the screen, in the order of their faces.

    Attributes:
        xy: (T, 3, 2) corners, pixels.
        inverse_depth: (T, 3) 1 / depth of the corners, or None where all lie at one depth.
        face: (T,) int64 the face that each is a part of.
        corners: (T, 3, 3) barycentric coordinates of each corner on that face, or None where they are the face's own.
        view: (T,) int64 the view that sees each, or None where there is one.
    """

    xy: Tensor
    inverse_depth: Tensor | None
    face: Tensor
    corners: Tensor | None
    view: Tensor | None = None

    def chosen(self, index: Tensor) -> "ScreenTriangles":
        """Those of `index`."""

        def part(of_all: Tensor | None) -> Tensor | None:
            return None if of_all is None else of_all[index]

        inverse_depth, corners, view = map(part, (self.inverse_depth, self.corners, self.view))
        return ScreenTriangles(self.xy[index], inverse_depth, self.face[index], corners, view)


def screen_triangles(vertices: Tensor, faces: Tensor, camera: Camera) -> ScreenTriangles:
    """The faces as the camera projects them, cut at the near plane."""
    xy, depth = project(vertices, camera)
    finite = torch.isfinite(vertices).all(dim=1)
    front = (depth >= NEAR) & finite
    covering = _may_cover(xy, faces)
    if bool(front.all()):
        whole, cut = covering.nonzero()[:, 0], faces.new_zeros(0)
    else:
        fronts = front[faces[:, 0]].int() + front[faces[:, 1]].int() + front[faces[:, 2]].int()
        whole = ((fronts == 3) & covering).nonzero()[:, 0]
        cut = ((fronts > 0) & (fronts < 3) & finite[faces].all(dim=1)).nonzero()[:, 0]
    inverse_depth = depth.reciprocal()
    at_corners = inverse_depth[faces[whole]]
    triangles = ScreenTriangles(xy[faces[whole]], at_corners, whole, None)
    return triangles if len(cut) == 0 else _with_cut_faces(triangles, at_corners, vertices, faces, cut, camera)


def _may_cover(xy: Tensor, faces: Tensor) -> Tensor:
    """(F,) bool: False only where a triangle lies between two columns or two rows of pixel centres.

    Of a dense mesh that is most of them, found before anything is computed for each.

    Args:
        xy: (N, 2) pixels.
    """
    # How many times a coordinate's two roundings count the gaps between centres: odd in a gap, even at a centre. Of
    # numbers so large that they are all even it says nothing.
    code = (xy - (0.5 + EDGE_TOLERANCE)).ceil_() + (xy - (0.5 - EDGE_TOLERANCE)).floor_()
    code = code.nan_to_num_(0.0).clamp_(-1e9, 1e9).long()
    x, y = code.unbind(dim=1)
    both = (x << 32) ^ (y & 0xFFFFFFFF)
    first, second, third = (both[faces[:, corner]] for corner in range(3))
    differ = (first ^ second) | (first ^ third)
    same_column = (differ >> 32 == 0) & (first >> 32 & 1 == 1)
    same_row = (differ & 0xFFFFFFFF == 0) & (first & 1 == 1)
    return ~(same_column | same_row)


def _with_cut_faces(
    triangles: ScreenTriangles, inverse_depth: Tensor, vertices: Tensor, faces: Tensor, cut: Tensor, camera: Camera
) -> ScreenTriangles:
    """`triangles` and the visible parts of the faces `cut` (P,), which cross the near plane."""
    points = vertices[faces[cut]]  # (P, 3, 3)
    depth = project(points, camera)[1]
    # Rotate the corners so that corner 0 is the one that lies alone on its side of the plane.
    front = depth >= NEAR
    lone_in_front = front.sum(dim=1) == 1
    lone = torch.where(lone_in_front, front.int().argmax(dim=1), (~front).int().argmax(dim=1))
    order = (lone[:, None] + torch.arange(3, device=lone.device)) % 3
    depth = depth.gather(1, order)
    own = torch.nn.functional.one_hot(order, 3).to(vertices.dtype)  # (P, corner, barycentric)
    share = ((NEAR - depth[:, :1]) / (depth[:, 1:] - depth[:, :1]))[..., None]  # (P, 2, 1) from corner 0 to 1 and 2
    crossing = own[:, :1] + share * (own[:, 1:] - own[:, :1])  # (P, 2, 3)
    tip = torch.stack([own[:, 0], crossing[:, 0], crossing[:, 1]], dim=1)[lone_in_front]
    base = torch.stack([crossing[:, 0], own[:, 1], own[:, 2]], dim=1)[~lone_in_front]
    rest = torch.stack([crossing[:, 0], own[:, 2], crossing[:, 1]], dim=1)[~lone_in_front]
    source = torch.arange(len(cut), device=cut.device)
    source = torch.cat([source[lone_in_front], source[~lone_in_front], source[~lone_in_front]])
    corners = torch.cat([tip, base, rest])
    xy, depth = project(corners @ points[source], camera)
    whole = torch.eye(3, dtype=corners.dtype, device=corners.device).expand(len(triangles.face), 3, 3)
    face = torch.cat([triangles.face, cut[source]])
    order = torch.argsort(face, stable=True)
    return ScreenTriangles(
        torch.cat([triangles.xy, xy])[order],
        torch.cat([inverse_depth, depth.clamp(min=NEAR).reciprocal()])[order],
        face[order],
        torch.cat([whole, corners])[order],
    )


def of_views(parts: list[ScreenTriangles]) -> ScreenTriangles:
    """What V views see, as one list."""
    if len(parts) == 1:
        return parts[0]
    corners = None
    if any(part.corners is not None for part in parts):
        own = torch.eye(3, dtype=parts[0].xy.dtype, device=parts[0].xy.device)
        corners = torch.cat([own.expand(len(p.face), 3, 3) if p.corners is None else p.corners for p in parts])
    inverse_depth = [part.inverse_depth for part in parts if part.inverse_depth is not None]
    counts = torch.tensor([len(part.face) for part in parts], device=parts[0].face.device)
    return ScreenTriangles(
        torch.cat([part.xy for part in parts]),
        torch.cat(inverse_depth) if inverse_depth else None,
        torch.cat([part.face for part in parts]),
        corners,
        torch.repeat_interleave(counts),
    )
