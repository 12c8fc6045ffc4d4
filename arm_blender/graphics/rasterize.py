"""Triangle rasterisation in plain torch: which face each pixel or texel sees, and where on that face.

Every pixel of each triangle's clipped bounding box is a candidate; candidates are tested against the three edges in
chunks of bounded size, and the nearest depth is kept by `scatter_reduce`. Nothing here is differentiable but
`interpolate`, which is linear in its attributes.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from .cameras import Camera, project

NEAR = 1e-2  # World units; what lies closer to the pinhole is cut off.
CHUNK = 1 << 18  # Candidate pixels tested at once: about 30 MB of work space, whatever the size of the triangles.
EDGE_TOLERANCE = 1e-4  # Pixels; keeps float32 rounding from opening cracks along shared edges.
MIN_AREA = 1e-12  # Square pixels, doubled area; below it a triangle is a line and has no inside.


@dataclass(frozen=True)
class Fragments:
    """What each pixel sees.

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


@dataclass(frozen=True)
class _Triangles:
    """Triangles on the screen, in the order of their faces.

    Attributes:
        xy: (T, 3, 2) corners, pixels.
        inverse_depth: (T, 3) 1 / depth of the corners, or None where all lie at one depth.
        face: (T,) int64 the face that each is a part of.
        corners: (T, 3, 3) barycentric coordinates of each corner on that face, or None where they are the face's own.
    """

    xy: Tensor
    inverse_depth: Tensor | None
    face: Tensor
    corners: Tensor | None


@torch.no_grad()
def rasterize(vertices: Tensor, faces: Tensor, camera: Camera) -> Fragments:
    """What `camera` sees of a mesh. Both windings are drawn; at equal depth the lowest face wins.

    Args:
        vertices: (N, 3) world. Faces with a vertex that is not finite are left out.
        faces: (F, 3) int64.
        camera: on the device of the vertices. Faces that cross its near plane are cut there.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"vertices (N, 3) and faces (F, 3) expected, got {vertices.shape}, {faces.shape}")
    return _scan(_screen_triangles(vertices, faces, camera), camera.height, camera.width)


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
    return _scan(_Triangles(corners[face_uvs[kept]], None, kept, None), size, size)


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
    pixel = fragments.mask.flatten().nonzero()[:, 0]
    corners = faces[fragments.face_id.flatten()[pixel]]  # (P, 3)
    weights = fragments.barycentric.flatten(1)[:, pixel].to(attributes.dtype)  # (3, P)
    values = sum(weights[i, :, None] * attributes[corners[:, i]] for i in range(3))
    image = attributes.new_zeros(height * width, attributes.shape[1])
    return image.index_copy(0, pixel, values).T.reshape(-1, height, width)


def _screen_triangles(vertices: Tensor, faces: Tensor, camera: Camera) -> _Triangles:
    """The faces as the camera projects them, cut at the near plane."""
    xy, depth = project(vertices, camera)
    finite = torch.isfinite(vertices).all(dim=1)
    front = (depth >= NEAR) & finite
    fronts = front[faces[:, 0]].int() + front[faces[:, 1]].int() + front[faces[:, 2]].int()
    whole = (fronts == 3).nonzero()[:, 0]
    cut = ((fronts > 0) & (fronts < 3) & finite[faces].all(dim=1)).nonzero()[:, 0]
    inverse_depth = depth.reciprocal()
    triangles = _Triangles(xy[faces[whole]], inverse_depth[faces[whole]], whole, None)
    return triangles if len(cut) == 0 else _with_cut_faces(triangles, vertices, faces, cut, camera)


def _with_cut_faces(triangles: _Triangles, vertices: Tensor, faces: Tensor, cut: Tensor, camera: Camera) -> _Triangles:
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
    return _Triangles(
        torch.cat([triangles.xy, xy])[order],
        torch.cat([triangles.inverse_depth, depth.clamp(min=NEAR).reciprocal()])[order],
        face[order],
        torch.cat([whole, corners])[order],
    )


def _scan(triangles: _Triangles, height: int, width: int) -> Fragments:
    """The nearest triangle at each pixel centre."""
    triangles, box, plane = _edges(triangles, height, width)
    device, count = triangles.face.device, len(triangles.face)
    nearest = torch.full((height * width,), torch.inf, dtype=triangles.xy.dtype, device=device)
    winner = torch.full((height * width,), count, dtype=torch.int32, device=device)
    ends = (box[:, 2] * box[:, 3]).cumsum(dim=0)
    starts = ends - box[:, 2] * box[:, 3]
    total = int(ends[-1]) if count else 0
    for begin in range(0, total, CHUNK):
        stop = min(begin + CHUNK, total)
        limits = torch.tensor([begin, stop - 1], device=device)
        first, last = torch.searchsorted(ends, limits, right=True).tolist()
        chosen = torch.arange(first, last + 1, device=device)
        counts = ends[first : last + 1].clamp(max=stop) - starts[first : last + 1].clamp(min=begin)
        triangle = chosen.repeat_interleave(counts, output_size=stop - begin)
        local = torch.arange(begin, stop, device=device) - starts[triangle]
        columns = box[triangle, 2]
        row = torch.div(local, columns, rounding_mode="floor")
        column = local - row * columns
        inside, weights = _weights(plane, triangle, column, row)
        kept = inside.nonzero()[:, 0]
        triangle, weights = triangle[kept], weights[:, kept]
        pixel = (box[triangle, 1] + row[kept]) * width + box[triangle, 0] + column[kept]
        _keep_nearest(nearest, winner, pixel, triangle, _depth(triangles, triangle, weights))
    return _fragments(triangles, box, plane, nearest, winner, height, width)


def _edges(triangles: _Triangles, height: int, width: int) -> tuple[_Triangles, Tensor, Tensor]:
    """The triangles that cover a pixel centre, their boxes and their edges.

    Returns:
        the triangles kept; (T, 4) int64 left, top, columns, rows of pixels; and (T, 9) weight 1, 2 as functions of
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
    ], dim=1)  # fmt: skip
    box = torch.stack([left, top, right - left + 1, bottom - top + 1], dim=1).long()[solid]
    kept = kept[solid]
    subset = _Triangles(
        triangles.xy[kept],
        None if triangles.inverse_depth is None else triangles.inverse_depth[kept],
        triangles.face[kept],
        None if triangles.corners is None else triangles.corners[kept],
    )
    return subset, box, plane[solid]


def _least(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    return torch.minimum(torch.minimum(a, b), c)


def _weights(plane: Tensor, triangle: Tensor, column: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
    """Whether candidates (P,) lie inside, and their (3, P) screen-space weights, clamped to the triangle."""
    x, y = column.to(plane.dtype), row.to(plane.dtype)
    x1, y1, c1, x2, y2, c2, slack0, slack1, slack2 = plane[triangle].unbind(1)
    second = x1 * x + y1 * y + c1
    third = x2 * x + y2 * y + c2
    first = 1.0 - second - third
    inside = (first >= -slack0) & (second >= -slack1) & (third >= -slack2)
    weights = torch.stack([first, second, third]).clamp_(min=0.0)
    return inside, weights / weights.sum(dim=0)


def _depth(triangles: _Triangles, triangle: Tensor, weights: Tensor) -> Tensor:
    """(P,) view-axis depth at screen-space weights (3, P)."""
    if triangles.inverse_depth is None:
        return weights.new_zeros(len(triangle))
    # 1 / depth, not depth, is linear on the screen.
    return (weights * triangles.inverse_depth[triangle].T).sum(dim=0).reciprocal()


def _keep_nearest(nearest: Tensor, winner: Tensor, pixel: Tensor, triangle: Tensor, depth: Tensor) -> None:
    """Enter candidates (P,) into the buffers; of equally near ones the lowest triangle stays."""
    before = nearest[pixel]
    nearest.scatter_reduce_(0, pixel, depth, "amin")
    after = nearest[pixel]
    winner[pixel[after < before]] = torch.iinfo(torch.int32).max
    best = (depth == after).nonzero()[:, 0]
    winner.scatter_reduce_(0, pixel[best], triangle[best].int(), "amin")


def _fragments(
    triangles: _Triangles, box: Tensor, plane: Tensor, nearest: Tensor, winner: Tensor, height: int, width: int
) -> Fragments:
    """What the buffers (H * W,) say, with barycentric coordinates on the faces."""
    pixel = torch.isfinite(nearest).nonzero()[:, 0]
    triangle = winner[pixel].long()
    column = pixel % width - box[triangle, 0]
    row = torch.div(pixel, width, rounding_mode="floor") - box[triangle, 1]
    weights = _weights(plane, triangle, column, row)[1]
    if triangles.inverse_depth is not None:
        weights = weights * triangles.inverse_depth[triangle].T
        weights = weights / weights.sum(dim=0)
    if triangles.corners is not None:
        weights = torch.einsum("ip,pij->jp", weights, triangles.corners[triangle])
    face_id = torch.full((height * width,), -1, dtype=torch.int64, device=nearest.device)
    face_id[pixel] = triangles.face[triangle]
    barycentric = nearest.new_zeros(3, height * width)
    barycentric[:, pixel] = weights
    return Fragments(face_id.view(height, width), barycentric.view(3, height, width), nearest.view(height, width))
