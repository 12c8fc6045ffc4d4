"""Gradients of rasterised pictures with respect to the mesh: inside faces exact, at outlines by anti-aliasing.

`rasterize` decides which face a pixel shows, and that decision has no derivative. Where on the face the pixel lies is a
smooth function of the vertices (`with_gradient`). Where outlines move over pixels is made one by `antialias`: along an
outline the two pixels beside it are blended by where it crosses between their centres (Laine et al., "Modular
primitives for high-performance differentiable rendering", 2020, section 3.5).
"""

from dataclasses import replace

import torch
from torch import Tensor

from .cameras import Camera, project
from .connectivity import half_edges, manifold_pairs
from .rasterize import Fragments


def with_gradient(fragments: Fragments, vertices: Tensor, faces: Tensor, camera: Camera) -> Fragments:
    """The same fragments, their barycentric coordinates and depths as differentiable functions of the vertices.

    Args:
        fragments: of these vertices and faces, seen by `camera`.
        vertices: (N, 3) world.
        faces: (F, 3) int64.
    """
    height, width = fragments.face_id.shape
    pixel = fragments.mask.flatten().nonzero()[:, 0]
    corners = faces[fragments.face_id.flatten()[pixel]]  # (P, 3)
    local = vertices @ camera.w2c[:3, :3].T + camera.w2c[:3, 3]
    depth = -local[:, 2]
    center = _centers(pixel, width)
    # Corners relative to the pixel, times their depth: homogeneous, so that corners behind the pinhole need no care.
    x = (camera.K[0, 0] * local[:, 0] + camera.K[0, 2] * depth)[corners] - center[:, :1] * depth[corners]
    y = (camera.K[1, 2] * depth - camera.K[1, 1] * local[:, 1])[corners] - center[:, 1:] * depth[corners]
    (x0, x1, x2), (y0, y1, y2) = x.unbind(1), y.unbind(1)
    weights = torch.stack([x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0])  # (3, P)
    total = weights.sum(dim=0)
    # A face seen edge-on has no area to share out; it keeps the coordinates it has, without a gradient.
    solid = total.abs() > torch.finfo(total.dtype).tiny
    known = fragments.barycentric.flatten(1)[:, pixel].to(total.dtype)
    weights = torch.where(solid, weights / torch.where(solid, total, 1.0), known)
    barycentric = vertices.new_zeros(3, height * width).index_copy(1, pixel, weights)
    surface = (weights.T * depth[corners]).sum(dim=1)
    depths = vertices.new_full((height * width,), torch.inf).index_copy(0, pixel, surface)
    return replace(fragments, barycentric=barycentric.view(3, height, width), depth=depths.view(height, width))


def antialias(image: Tensor, vertices: Tensor, faces: Tensor, fragments: Fragments, camera: Camera) -> Tensor:
    """Blend pixels along the outlines of the mesh, differentiable in `image` and `vertices`.

    An outline is an edge without a second face, or whose second face folds back on the screen. It is found between two
    pixels that show different faces if it belongs to the nearer one's: outlines of faces smaller than a pixel may be
    missed.

    Args:
        image: (C, H, W) of these fragments.
        vertices: (N, 3) world.
        faces: (F, 3) int64.
        fragments: what each pixel of `image` shows.
    Returns:
        (C, H, W).
    """
    near, far, step = _pairs(fragments)
    face = fragments.face_id.flatten()[near]
    screen = project(vertices, camera)[0]
    start, end, outline = _outlines(screen, faces, face)  # (P, 3, 2), (P, 3, 2), (P, 3)
    center = _centers(near, fragments.face_id.shape[1])[:, None]
    along, across = step[:, None], step.flip(1).abs()[:, None]  # Unit steps to the far pixel, and aside.
    a, b = ((start - center) * across).sum(-1), ((end - center) * across).sum(-1)
    crosses = outline & ((a <= 0) != (b <= 0))
    share = a / torch.where(crosses, a - b, 1.0)
    reach = torch.lerp(((start - center) * along).sum(-1), ((end - center) * along).sum(-1), share)  # Pixels.
    crosses = crosses & (reach >= 0.0) & (reach <= 1.0)
    pair, edge = crosses.nonzero().unbind(1)
    # How much of the far pixel the near one's surface covers (positive), or the far one's of the near (negative).
    cover = reach[pair, edge] - 0.5
    near, far = near[pair], far[pair]
    colors = image.flatten(1)
    change = cover * (colors[:, near] - colors[:, far])
    target = torch.where(cover > 0, far, near)
    return colors.index_add(1, target, change).view_as(image)


def _centers(pixel: Tensor, width: int) -> Tensor:
    """(P, 2) centres of flat pixels (P,) in an image of `width`."""
    return torch.stack([pixel % width, torch.div(pixel, width, rounding_mode="floor")], dim=1) + 0.5


def _pairs(fragments: Fragments) -> tuple[Tensor, Tensor, Tensor]:
    """Neighbouring pixels that show different faces: (P,) flat the nearer, (P,) the farther, (P, 2) step (x, y)."""
    height, width = fragments.face_id.shape
    index = torch.arange(height * width, device=fragments.face_id.device).view(height, width)
    found = []
    for axis, step in ((1, (1, 0)), (0, (0, 1))):
        size = fragments.face_id.shape[axis] - 1
        (id0, id1), (z0, z1), (p0, p1) = (
            (x.narrow(axis, 0, size), x.narrow(axis, 1, size)) for x in (fragments.face_id, fragments.depth, index)
        )
        differ = id0 != id1
        swap = (z1 < z0)[differ]
        p0, p1 = p0[differ], p1[differ]
        sign = torch.where(swap, -1.0, 1.0)[:, None].to(fragments.depth.dtype)
        found.append((torch.where(swap, p1, p0), torch.where(swap, p0, p1), sign * sign.new_tensor([step])))
    near, far, steps = zip(*found, strict=True)
    return torch.cat(near), torch.cat(far), torch.cat(steps)


def _outlines(screen: Tensor, faces: Tensor, face: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The edges of faces (P,) on the screen: starts and ends (P, 3, 2), and (P, 3) bool which of them are outlines."""
    pairs = manifold_pairs(faces)
    partner = torch.full((faces.numel(),), -1, dtype=torch.int64, device=faces.device)
    partner[pairs[:, 0]], partner[pairs[:, 1]] = pairs[:, 1], pairs[:, 0]
    row = 3 * face[:, None] + torch.arange(3, device=faces.device)
    edges = screen[half_edges(faces)[row]]  # (P, 3, 2 ends, 2)
    start, end = edges.unbind(2)
    own = screen[faces[face].roll(1, dims=1)]  # The corner opposite of each edge.
    other = partner[row]
    opposite = screen[faces.flatten()[torch.div(other, 3, rounding_mode="floor") * 3 + (other + 2) % 3]]
    folded = (_side(start, end, own) * _side(start, end, opposite)) >= 0
    return start, end, (other < 0) | folded


def _side(start: Tensor, end: Tensor, point: Tensor) -> Tensor:
    """Sign of the side of the line on which a point (..., 2) lies."""
    along, to = end - start, point - start
    return (along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]).sign()
