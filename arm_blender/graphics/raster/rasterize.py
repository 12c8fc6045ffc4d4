"""Triangle rasterisation in plain torch: which face each pixel or texel sees, and where on that face.

Each row of each triangle is cut to the span of pixels that its three edges leave, and all pixels of all spans are
listed, in chunks of bounded size; the nearest depth is kept by `scatter_reduce`. Nothing here is differentiable but
`interpolate`, which is linear in its attributes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..cameras import Camera
from ..ragged import enumerate_items, in_pieces, runs
from .screen_triangles import EDGE_TOLERANCE, ScreenTriangles, of_views, screen_triangles

CHUNK = 1 << 18  # Candidate pixels tested at once: about 30 MB of work space, whatever the size of the triangles.
MIN_AREA = 1e-12  # Square pixels, doubled area; below it a triangle is a line and has no inside.


@dataclass(frozen=True)
class Fragments:
    """What each pixel sees. Of V views at once all begin with (V, ...), and `fragments[i]` is what one of them sees.

    Attributes:
        face_id: (H, W) int64, -1 where nothing is.
        barycentric: (3, H, W) float32 in [0, 1], perspective correct, sum 1; 0 where nothing is.
        depth: (H, W) float32 along the view axis, world units; infinity where nothing is. 0 in an atlas.
    """

    face_id: Tensor
    barycentric: Tensor
    depth: Tensor

    @property
    def mask(self) -> Tensor:
        """(H, W) bool: a face is there."""
        return self.face_id >= 0

    def __getitem__(self, view: int) -> "Fragments":
        return Fragments(self.face_id[view], self.barycentric[view], self.depth[view])


@torch.no_grad()
def rasterize(vertices: Tensor, faces: Tensor, camera: Camera) -> Fragments:
    """What `camera` sees of a mesh. Both windings are drawn; at equal depth the lowest face wins.

    Args:
        vertices: (N, 3) world. Faces with a vertex that is not finite are left out.
        faces: (F, 3) int64.
        camera: on the device of the vertices. Faces that cross its near plane are cut there.
    """
    return rasterize_views(vertices, faces, (camera,))[0]


@torch.no_grad()
def rasterize_views(vertices: Tensor, faces: Tensor, cameras: Sequence[Camera]) -> Fragments:
    """As `rasterize`, all views at once, which saves the overhead of small pictures.

    Args:
        vertices, faces: as in `rasterize`.
        cameras: V of one size.
    Returns:
        (V, H, W) and (V, 3, H, W).
    Raises:
        ValueError: wrong shapes, no camera, or cameras of several sizes.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"vertices (N, 3) and faces (F, 3) expected, got {vertices.shape}, {faces.shape}")
    sizes = {(camera.height, camera.width) for camera in cameras}
    if len(sizes) != 1:
        raise ValueError(f"one size for all views expected, got {sorted(sizes) or 'no camera'}")
    triangles = of_views([screen_triangles(vertices, faces, camera) for camera in cameras])
    return _scan(triangles, len(cameras), *sizes.pop())


@torch.no_grad()
def rasterize_uv(uvs: Tensor, face_uvs: Tensor, size: int) -> Fragments:
    """Which face covers the centre of each texel; where charts overlap the lowest face wins.

    Args:
        uvs: (M, 2), v up. What lies outside [0, 1] is cut off.
        face_uvs: (F, 3) int64.
        size: texels a side; row 0 is v = 1.
    """
    if uvs.ndim != 2 or uvs.shape[1] != 2 or face_uvs.ndim != 2 or face_uvs.shape[1] != 3:
        raise ValueError(f"uvs (M, 2) and face_uvs (F, 3) expected, got {uvs.shape}, {face_uvs.shape}")
    corners = torch.stack([uvs[:, 0], 1.0 - uvs[:, 1]], dim=1) * size
    kept = torch.isfinite(corners).all(dim=1)[face_uvs].all(dim=1).nonzero()[:, 0]
    return _scan(ScreenTriangles(corners[face_uvs[kept]], None, kept, None), 1, size, size)[0]


def interpolate(attributes: Tensor, faces: Tensor, fragments: Fragments) -> Tensor:
    """Attributes of vertices at the pixels; 0 where nothing is. Differentiable in the attributes.

    Args:
        attributes: (N, C) per vertex.
        faces: (F, 3) int64, indices into `attributes`.
        fragments: of these faces.
    Returns:
        (C, H, W).
    """
    height, width = fragments.face_id.shape
    face_id, barycentric = fragments.face_id.flatten(), fragments.barycentric.flatten(1)

    def values(pixel: Tensor) -> tuple[Tensor]:
        a, b, c = faces[face_id[pixel]].unbind(1)
        first, second, third = barycentric[:, pixel].to(attributes.dtype)[..., None]  # (P, 1)
        return (first * attributes[a] + second * attributes[b] + third * attributes[c],)

    pixel = fragments.mask.flatten().nonzero()[:, 0]
    empty = attributes.new_zeros(height * width)
    channels = in_pieces(values, pixel)[0].unbind(dim=1)
    return torch.stack([empty.scatter(0, pixel, channel) for channel in channels]).reshape(-1, height, width)


def _scan(triangles: ScreenTriangles, views: int, height: int, width: int) -> Fragments:
    """The nearest triangle at each pixel centre of `views` pictures, which lie below one another."""
    triangles, box, plane = _edges(triangles, height, width)
    if triangles.view is not None:
        box[1] += triangles.view * height
    device, pixels = triangles.face.device, views * height * width
    nearest = torch.full((pixels,), torch.inf, dtype=triangles.xy.dtype, device=device)
    winner = torch.full((pixels,), len(triangles.face), dtype=torch.int32, device=device)
    for chosen in runs(box[3], CHUNK):
        owner, row = enumerate_items(box[3, chosen])
        triangle = chosen[owner]
        first, length = _spans(plane, box, triangle, row)
        kept = length.nonzero()[:, 0]
        triangle, row, first, length = triangle[kept], row[kept], first[kept], length[kept]
        left = (box[1, triangle] + row) * width + box[0, triangle] + first
        inverse_depth = _inverse_depth(triangles, plane, triangle, row, first)
        for part in runs(length, CHUNK):
            owner, local = enumerate_items(length[part])
            span = part[owner]
            depth = None if inverse_depth is None else _depth(inverse_depth[span], local)
            _keep_nearest(nearest, winner, left[span] + local, triangle[span], depth)
    return _fragments(triangles, box, plane, nearest, winner, (views, height, width))


def _spans(plane: Tensor, box: Tensor, triangle: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
    """(R,) first column in the box, and (R,) number, of the pixels that rows (R,) of triangles (R,) cover."""
    y = row.to(plane.dtype)
    x1, y1, c1, x2, y2, c2, slack0, slack1, slack2 = plane.index_select(1, triangle)
    second, third = y1 * y + c1, y2 * y + c2
    low, high = torch.zeros_like(y), (box[2, triangle] - 1).to(y)
    # Each weight is linear along the row; where it is at least -slack is a half line. One that does not change along
    # rows is that of an edge along them, and the box ends there.
    for slope, weight, slack in (
        (-x1 - x2, 1.0 - second - third, slack0), (x1, second, slack1), (x2, third, slack2)
    ):  # fmt: skip
        bound = -(weight + slack) / slope
        low = torch.where(slope > 0.0, torch.maximum(low, bound), low)
        high = torch.where(slope < 0.0, torch.minimum(high, bound), high)
    first = low.ceil()
    return first.long(), (high.floor() - first + 1.0).clamp(min=0.0).long()


def _edges(triangles: ScreenTriangles, height: int, width: int) -> tuple[ScreenTriangles, Tensor, Tensor]:
    """The triangles that cover a pixel centre, their boxes and their edges.

    Returns:
        the triangles kept; (4, T) int64 left, top, columns, rows of pixels; and (9, T) weight 1, 2 as functions of
        column and row within the box (x slope, y slope, constant) and the tolerance of weights 0, 1, 2.
    """
    (ax, bx, cx), (ay, by, cy) = triangles.xy[..., 0].unbind(1), triangles.xy[..., 1].unbind(1)
    # Clamped before they become integers, as a coordinate may exceed their range.
    left = (_least(ax, bx, cx) - 0.5 - EDGE_TOLERANCE).ceil().clamp(0, width)
    right = (-_least(-ax, -bx, -cx) - 0.5 + EDGE_TOLERANCE).floor().clamp(-1, width - 1)
    top = (_least(ay, by, cy) - 0.5 - EDGE_TOLERANCE).ceil().clamp(0, height)
    bottom = (-_least(-ay, -by, -cy) - 0.5 + EDGE_TOLERANCE).floor().clamp(-1, height - 1)
    kept = ((right >= left) & (bottom >= top)).nonzero()[:, 0]
    left, right, top, bottom = left[kept], right[kept], top[kept], bottom[kept]
    # Relative to the box's first pixel centre: there the subtraction of large screen coordinates loses no digits.
    ax, bx, cx = (x[kept] - left - 0.5 for x in (ax, bx, cx))
    ay, by, cy = (y[kept] - top - 0.5 for y in (ay, by, cy))
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    solid = area.abs() > MIN_AREA
    area = torch.where(solid, area, torch.full_like(area, torch.inf))
    slack = EDGE_TOLERANCE / area.abs()
    plane = torch.stack([
        (cy - ay) / area, (ax - cx) / area, (ay * cx - ax * cy) / area,
        (ay - by) / area, (bx - ax) / area, (ax * by - ay * bx) / area,
        slack * (cx - bx).hypot(cy - by), slack * (cx - ax).hypot(cy - ay), slack * (bx - ax).hypot(by - ay),
    ])  # fmt: skip
    box = torch.stack([left, top, right - left + 1, bottom - top + 1]).long()
    if not bool(solid.all()):
        kept, box, plane = kept[solid], box[:, solid], plane[:, solid]
    return triangles.chosen(kept), box, plane


def _least(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    return torch.minimum(torch.minimum(a, b), c)


def _weights(plane: Tensor, triangle: Tensor, column: Tensor, row: Tensor) -> Tensor:
    """(3, P) screen-space weights, clamped to the triangle, at pixels (P,) of triangles (P,)."""
    x, y = column.to(plane.dtype), row.to(plane.dtype)
    x1, y1, c1, x2, y2, c2 = plane[:6].index_select(1, triangle)
    second = x1 * x + y1 * y + c1
    third = x2 * x + y2 * y + c2
    weights = torch.stack([1.0 - second - third, second, third]).clamp_(min=0.0)
    return weights / weights.sum(dim=0)


def _inverse_depth(
    triangles: ScreenTriangles, plane: Tensor, triangle: Tensor, row: Tensor, first: Tensor
) -> Tensor | None:
    """(R, 4) 1 / depth along spans (R,): at the first pixel, its change from pixel to pixel, its least and its largest.

    1 / depth, not depth, is linear on the screen. None where all triangles lie at one depth.
    """
    if triangles.inverse_depth is None:
        return None
    corner = triangles.inverse_depth[triangle]
    x1, y1, c1, x2, y2, c2 = plane[:6].index_select(1, triangle)
    x, y = first.to(plane.dtype), row.to(plane.dtype)
    along1, along2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    start = corner[:, 0] + along1 * (x1 * x + y1 * y + c1) + along2 * (x2 * x + y2 * y + c2)
    return torch.stack([start, along1 * x1 + along2 * x2, *corner.aminmax(dim=1)], dim=1)


def _depth(inverse: Tensor, number: Tensor) -> Tensor:
    """(P,) view-axis depth of pixels number 0, 1, ... (P,) of spans `inverse` (P, 4) as of `_inverse_depth`."""
    start, slope, low, high = inverse.unbind(1)
    # Clamped: just outside of a triangle seen edge-on it may be anything.
    return torch.minimum(torch.maximum(start + slope * number, low), high).reciprocal_()


def _keep_nearest(nearest: Tensor, winner: Tensor, pixel: Tensor, triangle: Tensor, depth: Tensor | None) -> None:
    """Enter candidates (P,) into the buffers; of equally near ones the lowest triangle stays."""
    if depth is None:
        nearest[pixel] = 0.0
        winner.scatter_reduce_(0, pixel, triangle.int(), "amin")
        return
    before = nearest[pixel]
    nearest.scatter_reduce_(0, pixel, depth, "amin")
    after = nearest[pixel]
    winner[pixel[after < before]] = torch.iinfo(torch.int32).max
    best = (depth == after).nonzero()[:, 0]
    winner.scatter_reduce_(0, pixel[best], triangle[best].int(), "amin")


def _fragments(
    triangles: ScreenTriangles, box: Tensor, plane: Tensor, nearest: Tensor, winner: Tensor, shape: tuple[int, int, int]
) -> Fragments:
    """What the buffers (V * H * W,) say, with barycentric coordinates on the faces."""
    face_id = torch.full_like(nearest, -1, dtype=torch.int64)
    barycentric = nearest.new_zeros(3, len(nearest))
    for pixel in (winner < len(triangles.face)).nonzero()[:, 0].split(CHUNK):  # Pieces that stay in the cache.
        triangle = winner[pixel].long()
        line = torch.div(pixel, shape[2], rounding_mode="floor")
        weights = _weights(plane, triangle, pixel - line * shape[2] - box[0, triangle], line - box[1, triangle])
        if triangles.inverse_depth is not None:
            weights = weights * triangles.inverse_depth[triangle].T
            weights = weights / weights.sum(dim=0)
        if triangles.corners is not None:
            weights = torch.einsum("ip,pij->jp", weights, triangles.corners[triangle])
        face_id.scatter_(0, pixel, triangles.face[triangle])
        for corner in range(3):
            barycentric[corner].scatter_(0, pixel, weights[corner])
    return Fragments(face_id.view(shape), barycentric.view(3, *shape).transpose(0, 1), nearest.view(shape))
