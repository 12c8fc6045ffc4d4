"""The visual hull of posed silhouettes: how far points lie from every outline, and where rays first meet the hull.

Laurentini, "The visual hull concept for silhouette-based image understanding" (PAMI 1994).
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from .cameras import image_points

NEAREST = 0.05
"""World units; what lies closer to a pinhole, or behind it, is not framed."""

UNFRAMED = 0.5
"""Distance that a view reports where it frames nothing: neither inside nor outside, so never the least."""

VOTE_OUTSIDE, VOTE_INSIDE = 0.25, 0.04
"""World units outside and inside of the visual hull over which it votes on the occupancy."""

REACH = 1.75
"""A little over the box's half diagonal: rays are searched this far before and behind the origin."""


@dataclass(frozen=True)
class Projection:
    """P points of B objects in V views.

    Attributes:
        grid: (B, V, P, 2) in [-1, 1] over the image, as grid_sample takes it.
        local: (B, V, P, 3) in the camera's frame.
        depth: (B, V, P) along the view axis.
        pixel: (B, V, P) size of a pixel at that depth, world units.
        framed: (B, V, P) 1 where the view frames the point, else 0.
    """

    grid: Tensor
    local: Tensor
    depth: Tensor
    pixel: Tensor
    framed: Tensor

    def sample(self, maps: Tensor) -> Tensor:
        """(B, V, P, C) of maps (B, V, C, h, w), bilinear."""
        taps = self.grid.flatten(0, 1).unsqueeze(2)
        found = F.grid_sample(maps.flatten(0, 1), taps, padding_mode="border", align_corners=False)
        return found.squeeze(-1).transpose(1, 2).unflatten(0, maps.shape[:2])


@dataclass(frozen=True)
class Outlines:
    """Silhouettes of B objects in V views.

    Attributes:
        silhouette: (B, V, 2, S, S) coverage in [0, 1] and signed distance to the silhouette, pixels, inside positive.
        c2w: (B, V, 4, 4).
        K: (B, V, 3, 3) pixels of an image of S x S.
        told: (B, V, 4) left, top, right and bottom in [-1, 1] of what each view tells, as of `borders.continued`; None
            where that is all of every picture.
        ground: height (Z) of what the object stands on, where that is known.
    """

    silhouette: Tensor
    c2w: Tensor
    K: Tensor
    told: Tensor | None = None
    ground: float | None = None

    @property
    def range(self) -> Tensor:
        """(B, V) depth of the origin along each camera's view axis; its distance where the camera looks at it."""
        return (self.c2w[..., :3, 2] * self.c2w[..., :3, 3]).sum(dim=-1)

    def project(self, points: Tensor) -> Projection:
        """Where world points (B, P, 3) lie in every view."""
        size = self.silhouette.shape[-1]
        # Half precision would round coordinates to several pixels.
        with torch.autocast(points.device.type, enabled=False):
            local = (points.unsqueeze(1) - self.c2w[..., None, :3, 3]) @ self.c2w[..., :3, :3]
        depth = -local[..., 2]
        near = depth.clamp(min=NEAREST)
        K = self.K.unsqueeze(-3)
        grid = (2.0 * image_points(local, near, K) / size - 1.0).clamp(-2.0, 2.0)
        framed = (self.tells(grid) & (depth > NEAREST)).to(points)
        return Projection(grid, local, depth, near / K[..., 0, 0], framed)

    def tells(self, grid: Tensor) -> Tensor:
        """(B, V, P) bool: whether a view tells of the places (B, V, P, 2) in its picture, in [-1, 1]."""
        if self.told is None:
            return grid.abs().amax(dim=-1) <= 1.0
        low, high = self.told[..., None, :2], self.told[..., None, 2:]
        return ((grid >= low) & (grid <= high)).all(dim=-1)

    def read(self, seen: Projection) -> tuple[Tensor, Tensor]:
        """(B, V, P) coverage, and signed silhouette distance in world units at the points' depths."""
        coverage, pixels = seen.sample(self.silhouette).unbind(-1)
        return coverage, torch.where(seen.framed > 0, pixels * seen.pixel, UNFRAMED)

    def hull_distance(self, points: Tensor) -> Tensor:
        """(B, P) least signed silhouette distance over the views, world units: positive inside the visual hull.

        Below the ground nothing is inside.
        """
        distance = self.read(self.project(points))[1].amin(dim=1)
        return distance if self.ground is None else torch.minimum(distance, points[..., 2] - self.ground)

    def hull_depth(self, side: int, steps: int = 24) -> Tensor:
        """Where the ray of every pixel first meets the visual hull within the box, as `first_met`."""

        def distance(item: int, points: Tensor) -> Tensor:
            return self.item(item).hull_distance(points[None])[0]

        return self.first_met(side, distance, steps)

    def item(self, index: int) -> "Outlines":
        """Those of one object, B = 1."""
        only = slice(index, index + 1)
        told = None if self.told is None else self.told[only]
        return Outlines(self.silhouette[only], self.c2w[only], self.K[only], told, self.ground)

    def apart(self) -> "Outlines":
        """Of each view its own, as an object with one view: B x V objects."""
        silhouette, c2w, K = (part.flatten(0, 1).unsqueeze(1) for part in (self.silhouette, self.c2w, self.K))
        told = None if self.told is None else self.told.flatten(0, 1).unsqueeze(1)
        return Outlines(silhouette, c2w, K, told, self.ground)

    @torch.no_grad()
    def first_met(self, side: int, solid: Callable[[int, Tensor], Tensor], steps: int) -> Tensor:
        """Where the ray of every pixel first meets a solid within the box.

        Args:
            side: pixels a side of the result.
            solid: of an object (its number) and world points (P, 3) a value (P,), positive inside.
            steps: samples along a ray; between two of them the crossing is linear.
        Returns:
            (B, V, 2, side, side): 1 where the solid is met, and the depth there beyond the origin's, world units;
            0 where it is not.
        """
        batch, views = self.c2w.shape[:2]
        result = self.c2w.new_zeros(batch, views, 2, side, side)
        offsets = torch.linspace(-REACH, REACH, steps, device=self.c2w.device)
        for item in range(batch):
            pixels, origin, rays, reach = self._rays(item, side, 0.25)
            depth = (reach[:, None] + offsets).clamp(min=NEAREST)  # (R, steps)
            points = origin[:, None] + rays[:, None] * depth[..., None]
            # The object lies in the box: without it the hull of a single view would begin at the camera.
            value = solid(item, points.reshape(-1, 3)).view(depth.shape)
            value = torch.minimum(value, 1.0 - points.abs().amax(dim=-1))
            inside = value > 0
            met, first = inside.any(dim=1), inside.int().argmax(dim=1).clamp(min=1)
            after, before = (value.gather(1, (first - back)[:, None])[:, 0] for back in (0, 1))
            share = (after / (after - before).clamp(min=1e-6)).clamp(0.0, 1.0)
            crossing = depth.gather(1, first[:, None])[:, 0] - share * (offsets[1] - offsets[0]) - reach
            result[item, :, 0][pixels] = met.to(result)
            result[item, :, 1][pixels] = torch.where(met, crossing, 0.0)
        return result

    @torch.no_grad()
    def highest(self, side: int, solid: Callable[[int, Tensor], Tensor], steps: int, lowest: float) -> Tensor:
        """The largest value of a solid within the box along the ray of every pixel of the silhouettes.

        Args:
            side, solid, steps: as in `first_met`. lowest: what counts outside of the box.
        Returns:
            (B, V, side, side); infinity where the view shows nothing, or tells nothing.
        """
        result = self.c2w.new_full((*self.c2w.shape[:2], side, side), torch.inf)
        for item in range(len(self.c2w)):
            pixels, origin, rays, reach = self._rays(item, side, 0.5)
            best = reach.new_full(reach.shape, lowest)
            # One step after the other: all of them at once would be a hundred megabytes.
            for offset in torch.linspace(-REACH, REACH, steps).tolist():
                points = origin + rays * (reach + offset).clamp(min=NEAREST)[:, None]
                value = torch.where(points.abs().amax(dim=1) <= 1.0, solid(item, points), lowest)
                best = torch.maximum(best, value)
            result[item][pixels] = best
        centers = (torch.arange(side, device=result.device) + 0.5) * (2.0 / side) - 1.0
        rows, columns = torch.meshgrid(centers, centers, indexing="ij")
        places = torch.stack([columns, rows], dim=-1).flatten(0, 1).expand(*result.shape[:2], -1, -1)
        return result.masked_fill(~self.tells(places).view_as(result), torch.inf)

    def _rays(self, item: int, side: int, coverage: float) -> tuple[tuple[Tensor, ...], Tensor, Tensor, Tensor]:
        """The pixels of an object's views, `side` a side, that are covered by more than `coverage`, and their rays.

        Returns:
            (R,) view, row and column; (R, 3) origins; (R, 3) directions, one unit of depth long; (R,) depth of the
            world's origin.
        """
        size, device = self.silhouette.shape[-1], self.c2w.device
        centers = (torch.arange(side, device=device) + 0.5) * (size / side)
        share = F.interpolate(self.silhouette[item, :, :1], size=(side, side), mode="bilinear", align_corners=False)
        view, row, column = pixels = (share[:, 0] > coverage).nonzero(as_tuple=True)
        K, c2w = self.K[item, view], self.c2w[item, view]
        x = (centers[column] - K[:, 0, 2]) / K[:, 0, 0]
        y = (K[:, 1, 2] - centers[row]) / K[:, 1, 1]
        rays = torch.stack([x, y, -torch.ones_like(x)], dim=-1)
        return pixels, c2w[:, :3, 3], (c2w[:, :3, :3] * rays.unsqueeze(1)).sum(dim=-1), self.range[item, view]


def hull_vote(hull: Tensor, gain: float) -> Tensor:
    """Occupancy logits for hull distances: outside there is nothing; inside, learning decides, so the vote is weak.

    Args:
        hull: world units, as of `Outlines.hull_distance`. gain: logits for each of them.
    """
    return gain * hull.clamp(-VOTE_OUTSIDE, VOTE_INSIDE)


COLUMNS_AT_ONCE = 16
"""Bounds the distance transform's memory: 7 MB for images of 320 pixels."""

FAR = 1e3
"""Pixels: farther than this from any occupied pixel is all the same."""


def squared_distance(occupied: Tensor, reach: int | None = None) -> Tensor:
    """Exact squared Euclidean distance in pixels to the nearest occupied pixel: along rows, then a min-plus pass.

    Args:
        occupied: (V, H, W) bool.
        reach: rows beyond which it need not be exact, only larger; it saves most of the time. None for all.
    Returns:
        (V, H, W) float32; 1e6 where a view has no occupied pixel.
    """
    columns = torch.arange(occupied.shape[-1], device=occupied.device, dtype=torch.float32)
    left = torch.where(occupied, columns, -FAR).cummax(dim=-1).values
    right = torch.where(occupied, columns, columns[-1] + FAR).flip(-1).cummin(dim=-1).values.flip(-1)
    along = torch.minimum(columns - left, right - columns).square()
    if reach is not None:
        lowest = along.clone()
        for step in range(1, min(reach, occupied.shape[1] - 1) + 1):
            lowest[:, step:] = torch.minimum(lowest[:, step:], along[:, :-step] + step**2)
            lowest[:, :-step] = torch.minimum(lowest[:, :-step], along[:, step:] + step**2)
        return lowest.clamp(max=FAR**2)
    cost = along.transpose(1, 2)  # (V, W, H)
    rows = torch.arange(cost.shape[-1], device=cost.device, dtype=torch.float32)
    parabolas = (rows[:, None] - rows[None, :]) ** 2
    pieces = [(part.unsqueeze(1) + parabolas).amin(dim=-1) for part in cost.flatten(0, 1).split(COLUMNS_AT_ONCE)]
    return torch.cat(pieces).view_as(cost).transpose(1, 2).clamp(max=FAR**2)


def signed_silhouette_distance(alpha: Tensor, reach: int | None = None) -> Tensor:
    """(V, H, W) signed distance in pixels to the outline alpha = 1/2, positive inside; `alpha` is (V, H, W).

    Where it is more than `reach` it need not be exact, only more.
    """
    inside = alpha >= 0.5
    # The outline runs half a pixel beyond the centres of its pixels.
    within, beyond = (squared_distance(there, reach).sqrt().sub(0.5).clamp(min=0.0) for there in (~inside, inside))
    return within - beyond
