"""Where along its normal the pictures agree on the colours around a vertex: a plane sweep, a vertex at a time.

Collins, "A space-sweep approach to true multi-image matching" (CVPR 1996), with planes tangent to the surface.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from ..graphics.cameras import Camera, directions_to, project
from ..graphics.raster.rasterize import Fragments
from .picture_evidence import PictureEvidence

PATCH = 5
"""Samples along a side of a patch."""

AT_ONCE = 1024
"""Vertices compared in one go: what is computed for them stays small, and a stop is noticed soon."""

NOISE = 0.015
"""sRGB of a sample below which a patch has no pattern to compare."""

OPAQUE = 0.7
"""Coverage of every sample of a patch: what reaches over an outline shows the background as well."""

GRAZING, BEHIND = 0.2, 0.025
"""Cosine below which a view tells nothing of a vertex, and world units that it may lie behind what the view sees."""

LEAST_PAIR = 1e-3
"""Weight of all pairs of views below which they say nothing."""


def visibility(
    vertices: Tensor, normals: Tensor, views: Sequence[PictureEvidence], fragments: Sequence[Fragments]
) -> Tensor:
    """(V, N) how well each view sees each vertex, 0 to 1; its cosine.

    Args:
        vertices: (N, 3). normals: (N, 3) unit.
        fragments: what the `outline_camera` of each view sees of the mesh.
    """
    found = []
    for view, seen in zip(views, fragments, strict=True):
        camera = view.outline_camera
        pixels, depth = project(vertices, camera)
        # Of the pixels around the farthest: beside an edge the vertex itself is behind nothing.
        surface = torch.where(seen.mask, seen.depth, 0.0)[None, None]
        farthest = F.max_pool2d(surface, 3, stride=1, padding=1)[0, 0]
        column, row = (pixels[:, k].clamp(0, end - 1).long() for k, end in ((0, camera.width), (1, camera.height)))
        front = (depth > 0.0) & (depth < farthest[row, column] + BEHIND) & view.tells(pixels)
        cosine = (directions_to(camera.center, vertices) * normals).sum(dim=1)
        found.append(torch.where(front & (cosine > GRAZING), cosine, 0.0))
    return torch.stack(found)


def correlation(
    vertices: Tensor,
    normals: Tensor,
    seen: Tensor,
    views: Sequence[PictureEvidence],
    spacing: float,
    offsets: Tensor,
    tick: Callable[[], None],
) -> tuple[Tensor, Tensor]:
    """How alike the views are around vertices that are moved along their normals.

    Args:
        vertices: (N, 3). normals: (N, 3) unit.
        seen: (V, N) as of `visibility`.
        spacing: world units between the samples of a patch.
        offsets: (K,) world units along the normal.
        tick: called now and then; what it raises passes through.
    Returns:
        (N, K) mean over pairs of views of their zero-mean normalised cross-correlation, -1 to 1; and (N, K) the pairs'
        weight. Both 0 where fewer than two views see the patch.
    """
    alike, weight = (vertices.new_zeros(len(vertices), len(offsets)) for _ in range(2))
    steps = (torch.arange(PATCH, device=vertices.device) - PATCH // 2) * spacing
    for chosen in ((seen > 0.0).sum(dim=0) >= 2).nonzero()[:, 0].split(AT_ONCE):
        patches = _Patches.of(vertices[chosen], normals[chosen], steps, offsets)
        alike[chosen], weight[chosen] = _pairs(patches, seen[:, chosen], views, tick)
    return alike, weight


@dataclass(frozen=True)
class _Patches:
    """Tangent patches of n vertices at K offsets along their normals, P = PATCH**2 samples each.

    Attributes:
        frame: (n, 4, 4) rows: the normal, right, up, the vertex; homogeneous.
        offsets: (K,). across: (P, 2) samples to the right and up.
    """

    frame: Tensor
    offsets: Tensor
    across: Tensor

    @staticmethod
    def of(vertices: Tensor, normals: Tensor, steps: Tensor, offsets: Tensor) -> "_Patches":
        axis = torch.eye(3, device=normals.device)[normals.abs().argmin(dim=1)]
        right = F.normalize(torch.linalg.cross(normals, axis, dim=1), dim=1)
        up = torch.linalg.cross(normals, right, dim=1)
        frame = torch.stack([normals, right, up, vertices], dim=1)
        kind = frame.new_tensor([0.0, 0.0, 0.0, 1.0])  # Three directions and a point.
        frame = torch.cat([frame, kind[:, None].expand(len(frame), 4, 1)], dim=2)
        return _Patches(frame, offsets, torch.cartesian_prod(steps, steps))

    def places(self, camera: Camera, which: Tensor) -> Tensor:
        """(1, m * K, P, 2) where the patches (m,) lie in a picture, in [-1, 1] as grid_sample takes them."""
        K = camera.K.clone()
        K[:2] *= K.new_tensor([2.0 / camera.width, 2.0 / camera.height])[:, None]
        K[:2, 2] -= 1.0
        # Homogeneous coordinates are linear: what the offsets and the samples add is known for all of them at once.
        lens = (K * K.new_tensor([1.0, -1.0, -1.0])) @ camera.w2c[:3]  # (3, 4)
        normal, right, up, center = (self.frame[which] @ lens.T).unbind(dim=1)  # (m, 3)
        along = center[:, None] + self.offsets[:, None] * normal[:, None]
        across = self.across[:, :1] * right[:, None] + self.across[:, 1:] * up[:, None]
        x, y, depth = (along[:, :, None, axis] + across[:, None, :, axis] for axis in range(3))
        return torch.stack([x / depth, y / depth], dim=-1).flatten(0, 1)[None]


def _pairs(
    patches: _Patches, seen: Tensor, views: Sequence[PictureEvidence], tick: Callable[[], None]
) -> tuple[Tensor, Tensor]:
    """(n, K) mean correlation over pairs of views, and (n, K) the pairs' weight."""
    count, places, samples = len(patches.frame), len(patches.offsets), len(patches.across)
    total = seen.new_zeros(3, count, places, samples)
    weights, squares, own = (seen.new_zeros(count, places) for _ in range(3))
    for view, visible in zip(views, seen, strict=True):
        there = (visible > 0.0).nonzero()[:, 0]
        if not len(there):
            continue
        tick()
        grid = patches.places(view.color_camera, there)
        found = F.grid_sample(view.color[None], grid, padding_mode="border", align_corners=False)[0]
        found = found.view(4, len(there), places, samples)
        opaque = (found[3].amin(dim=-1) > OPAQUE).to(found)
        color = found[:3] - found[:3].mean(dim=-1, keepdim=True)
        power = color.square().sum(dim=(0, 3))
        # Divided so that a patch without a pattern is like nothing, not like everything.
        scale = (power + 3 * samples * NOISE**2).rsqrt()
        weight = visible[there, None] * opaque
        total[:, there] += (weight * scale)[..., None] * color
        weights[there] += weight
        squares[there] += weight.square()
        own[there] += (weight * scale).square() * power
    # The square of a sum holds every pair twice and every view with itself once.
    pairs = weights.square() - squares
    enough = pairs > LEAST_PAIR
    alike = (total.square().sum(dim=(0, 3)) - own) / pairs.clamp(min=LEAST_PAIR)
    return torch.where(enough, alike, 0.0), torch.where(enough, pairs, 0.0)
