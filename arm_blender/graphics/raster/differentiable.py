"""Gradients of rasterised pictures with respect to the mesh: inside faces exact, at outlines by anti-aliasing.

`rasterize` decides which face a pixel shows, and that decision has no derivative. Where on the face the pixel lies is a
smooth function of the vertices (`with_gradient`). Where outlines move over pixels is made one by `antialias`: along an
outline the two pixels beside it are blended by where it crosses between their centres (after Laine et al., "Modular
primitives for high-performance differentiable rendering", 2020, section 3.5).
"""

from dataclasses import replace

import torch
from torch import Tensor

from ..cameras import Camera, project
from ..connectivity import half_edges, manifold_pairs
from ..ragged import enumerate_items
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

    An outline is an edge without a second face, or whose second face folds back on the screen. Unlike in the paper
    named above, each is followed by itself over the pixels: to look for it among the edges of the face that a pixel
    shows finds next to none where faces at the limb are narrower than a pixel. Steep outlines blend neighbours in a
    row, flat ones those in a column: each once, so that the sum of a mask is the area. What covers no pixel's centre
    stays unseen.

    Args:
        image: (C, H, W) of these fragments.
        vertices: (N, 3) world.
        faces: (F, 3) int64.
        fragments: what each pixel of `image` shows.
    Returns:
        (C, H, W).
    """
    screen, depth = project(vertices, camera)
    edges, solid = _outlines(screen.detach(), depth.detach(), faces)
    crossings = [_crossings(screen, depth.detach(), edges, solid, fragments, axis) for axis in (0, 1)]
    near, far, reach = (torch.cat(parts) for parts in zip(*crossings, strict=True))
    # Several outlines between two centres: what the nearer pixel shows reaches as far as the farthest.
    key = near * fragments.mask.numel() + far
    order = reach.detach().argsort()
    order = order[key[order].argsort(stable=True)]
    last = torch.ones_like(order, dtype=torch.bool)
    last[:-1] = key[order[1:]] != key[order[:-1]]
    near, far, reach = (x[order[last]] for x in (near, far, reach))
    # How much of the far pixel the near one's surface covers (positive), or the far one's of the near (negative).
    cover = reach - 0.5
    colors = image.flatten(1)
    change = cover * (colors[:, near] - colors[:, far])
    return colors.index_add(1, torch.where(cover > 0, far, near), change).view_as(image)


def _outlines(screen: Tensor, depth: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Outlines as pairs of vertices (E, 2), and (E,) the sign of the side on which the surface is, as `_side`."""
    pairs = manifold_pairs(faces)
    partner = torch.full((faces.numel(),), -1, dtype=torch.int64, device=faces.device)
    partner[pairs[:, 0]], partner[pairs[:, 1]] = pairs[:, 1], pairs[:, 0]
    edges, across = half_edges(faces), faces.roll(1, dims=1).flatten()  # Of each edge, the corner opposite of it.
    start, end = screen[edges].unbind(1)
    own = _side(start, end, screen[across])
    other = torch.where(partner < 0, own, _side(start, end, screen[across[partner]]))
    first = partner < torch.arange(len(partner), device=faces.device)  # Each edge once, and those without a partner.
    # A face seen edge-on has no side: its partner's counts.
    chosen = (first & (own * other >= 0) & (own + other != 0) & (depth[edges] > 0).all(dim=1)).nonzero()[:, 0]
    return edges[chosen], (own + other).sign()[chosen]


def _crossings(
    screen: Tensor, depth: Tensor, edges: Tensor, solid: Tensor, fragments: Fragments, axis: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Where outlines pass between the centres of neighbouring pixels, and are seen there.

    Args:
        edges, solid: as `_outlines` returns them.
        axis: 0 for neighbours in a row, 1 in a column.
    Returns:
        (P,) flat pixel on the surface's side, (P,) flat pixel beyond, (P,) pixels from the former's centre to the
        outline, 0 to 1, differentiable.
    """
    height, width = fragments.face_id.shape
    (count, lines), (step, stride) = ((width, height), (1, width)) if axis == 0 else ((height, width), (width, 1))
    start, end = screen[edges].unbind(1)
    run, rise = ((end - start).detach().abs()[:, k] for k in (axis, 1 - axis))
    steep = ((rise > run) if axis == 0 else (rise >= run)).nonzero()[:, 0]
    edges, solid, start, end = edges[steep], solid[steep], start[steep], end[steep]
    low, high = torch.minimum(start, end).detach()[:, 1 - axis], torch.maximum(start, end).detach()[:, 1 - axis]
    # Half open, so that what two edges share is met once.
    first = (low - 0.5).ceil().clamp(0, lines)
    owner, number = enumerate_items(((high - 0.5).ceil().clamp(0, lines) - first).long())
    line = first[owner].long() + number
    start, end = start[owner], end[owner]
    share = (line + 0.5 - start[:, 1 - axis]) / (end - start)[:, 1 - axis]
    place = torch.lerp(start[:, axis], end[:, axis], share)
    before = (place.detach() - 0.5).floor()  # The pixel before the crossing; the next one is behind it.
    inside = (before >= 0) & (before < count - 1)
    before = before.long().clamp(0, count - 2)
    pixel = before * step + line * stride
    # The sign that a point before the crossing has: `_side` of a step back along the axis.
    along = (end - start).detach()[:, 1 - axis].sign() * (1.0 if axis == 0 else -1.0)
    surface_before = along == solid[owner]
    near, far = torch.where(surface_before, pixel, pixel + step), torch.where(surface_before, pixel + step, pixel)
    seen, shown = fragments.depth.detach().flatten(), fragments.face_id.flatten()
    inverse_start, inverse_end = (1.0 / depth[edges[owner]]).unbind(1)
    inverse = torch.lerp(inverse_start, inverse_end, share.detach())
    visible = (seen[near] < seen[far]) & (shown[near] != shown[far]) & (inverse * seen[far] > 1.0)
    kept = (inside & visible).nonzero()[:, 0]
    center = before + 0.5
    reach = torch.where(surface_before, place - center, center + 1.0 - place)
    return near[kept], far[kept], reach[kept]


def _centers(pixel: Tensor, width: int) -> Tensor:
    """(P, 2) centres of flat pixels (P,) in an image of `width`."""
    return torch.stack([pixel % width, torch.div(pixel, width, rounding_mode="floor")], dim=1) + 0.5


def _side(start: Tensor, end: Tensor, point: Tensor) -> Tensor:
    """Sign of the side of the line on which a point (..., 2) lies."""
    along, to = end - start, point - start
    return (along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]).sign()
