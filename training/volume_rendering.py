"""Volume rendering of a density in the box [-1, 1]^3: rays, their samples, and what they see of a surface.

The model is that of Max (1995) and NeRF (Mildenhall et al. 2020, section 4), sampled as InstantMesh does: jittered
coarse samples, importance samples where these found something, and densities that are averaged between neighbours
before they are activated. Written from its formulas and proven by its numbers; the paper's first stage of GeoRM.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F
from torch.utils.checkpoint import checkpoint

RawDensity = Callable[[Tensor], Tensor]
"""World points (B, P, 3) to raw densities (B, P); the density is softplus(raw - 1)."""

NORMAL_STEP = 0.01
"""World units from a point to where its gradient is measured; about a texel of the paper's planes."""

_FLAT = 1e-3
"""Raw density per world unit, below which a gradient has no direction: the normal fades instead of jumping."""


@dataclass(frozen=True)
class SamplingConfig:
    """Where a ray is sampled."""

    coarse: int = 64
    """Evenly spread over the box, jittered. Too few miss thin parts, and what they miss is not refined."""
    fine: int = 64
    """Drawn where the coarse ones found density."""
    rays_at_once: int = 4096
    """Bounds the memory: the samples of so many rays of an object are held at a time, and computed again for the
    gradient."""


@dataclass(frozen=True)
class Rays:
    """R rays of each of B objects.

    Attributes:
        origins: (B, R, 3) world.
        directions: (B, R, 3) unit length.
    """

    origins: Tensor
    directions: Tensor

    def at(self, depths: Tensor) -> Tensor:
        """(B, R, S, 3) points at distances (B, R, S) along the rays."""
        return self.origins[..., None, :] + depths[..., None] * self.directions[..., None, :]

    def box_span(self) -> tuple[Tensor, Tensor]:
        """Distances (B, R) at which the rays enter and leave the box; equal where they miss it, or it is behind."""
        # A ray along a face has no crossing with that pair of faces; this puts it far away.
        steep = torch.where(self.directions.abs() < 1e-9, 1e-9, self.directions)
        first, second = (-1.0 - self.origins) / steep, (1.0 - self.origins) / steep
        entry = torch.minimum(first, second).amax(dim=-1).clamp(min=0.0)
        leave = torch.maximum(first, second).amin(dim=-1)
        return torch.where(leave > entry, entry, 0.0), torch.where(leave > entry, leave, 0.0)


@dataclass(frozen=True)
class Draws:
    """What chance has a say in.

    Attributes:
        jitter: (B, R, coarse) in [0, 1): place of a coarse sample between its neighbours.
        quantile: (B, R, fine) in [0, 1): of the distribution that importance samples follow.
    """

    jitter: Tensor
    quantile: Tensor


@dataclass(frozen=True)
class Rendering:
    """What the rays see.

    Attributes:
        mask: (B, R) opacity in [0, 1].
        depth: (B, R) distance along the ray, world units, times the opacity: 0 where nothing is.
        normal: (B, R, 3) world, outward, at most of unit length.
    """

    mask: Tensor
    depth: Tensor
    normal: Tensor


def pixel_rays(pixels: Tensor, c2w: Tensor, K: Tensor) -> Rays:
    """Rays through image points.

    Args:
        pixels: (V, R, 2) x right, y down; pixel centres at +0.5.
        c2w: (V, 4, 4). K: (V, 3, 3) pixels.
    """
    x = (pixels[..., 0] - K[:, None, 0, 2]) / K[:, None, 0, 0]
    y = (K[:, None, 1, 2] - pixels[..., 1]) / K[:, None, 1, 1]
    local = torch.stack([x, y, -torch.ones_like(x)], dim=-1)
    directions = F.normalize(local @ c2w[:, :3, :3].transpose(1, 2), dim=-1)
    return Rays(c2w[:, None, :3, 3].expand_as(directions), directions)


def draw(rays: Rays, config: SamplingConfig, generator: torch.Generator) -> Draws:
    """Draws for `rays` by a generator on the CPU."""
    shape, device = rays.origins.shape[:2], rays.origins.device
    return Draws(*(torch.rand(*shape, count, generator=generator).to(device) for count in (config.coarse, config.fine)))


def render(field: RawDensity, rays: Rays, draws: Draws, rays_at_once: int) -> Rendering:
    """Opacity, depth and normal of every ray, differentiable in what `field` computes from.

    Args:
        rays_at_once: as in `SamplingConfig`.
    """

    def part(origins: Tensor, directions: Tensor, jitter: Tensor, quantile: Tensor) -> tuple[Tensor, ...]:
        some = Rays(origins, directions)
        depths, weights = march(field, some, Draws(jitter, quantile))
        mask, depth = weights.sum(dim=-1), expected_depth(depths, weights)
        surface = (depth / mask.clamp(min=1e-6)).detach()  # Where the normal is asked is no one's to move.
        return mask, depth, outward_normal(field, some.at(surface[..., None])[..., 0, :])

    everything = (rays.origins, rays.directions, draws.jitter, draws.quantile)
    parts = [
        checkpoint(part, *chunk, use_reentrant=False)
        for chunk in zip(*(x.split(rays_at_once, dim=1) for x in everything), strict=True)
    ]
    return Rendering(*(torch.cat(maps, dim=1) for maps in zip(*parts, strict=True)))


def march(field: RawDensity, rays: Rays, draws: Draws) -> tuple[Tensor, Tensor]:
    """Sample the rays.

    Returns:
        (B, R, S) distances, ascending, of all S = coarse + fine samples, and (B, R, S - 1) how much of what the ray
        sees lies between each two.
    """
    coarse = coarse_depths(*rays.box_span(), draws.jitter)
    raw = raw_in_box(field, rays.at(coarse))
    with torch.no_grad():
        fine = fine_depths(coarse, interval_weights(raw, coarse), draws.quantile)
    depths, order = torch.cat([coarse, fine], dim=-1).sort(dim=-1)
    raw = torch.cat([raw, raw_in_box(field, rays.at(fine))], dim=-1).gather(-1, order)
    return depths, interval_weights(raw, depths)


def coarse_depths(entry: Tensor, leave: Tensor, jitter: Tensor) -> Tensor:
    """(B, R, N) distances from `entry` to `leave` (B, R), each moved on by a share `jitter` of the spacing."""
    count = jitter.shape[-1]
    steps = torch.arange(count, device=jitter.device) + jitter
    return entry[..., None] + (leave - entry)[..., None] / (count - 1) * steps


def fine_depths(depths: Tensor, weights: Tensor, quantile: Tensor) -> Tensor:
    """Distances distributed as the weights, a little spread (NeRF, section 5.2; spread as in Mip-NeRF, equation 19).

    Args:
        depths: (B, R, N). weights: (B, R, N - 1) of the intervals between them.
        quantile: (B, R, M) in [0, 1).
    Returns:
        (B, R, M), in the order of the quantiles.
    """
    flat = weights.flatten(0, -2)[:, None]  # (B * R, 1, N - 1)
    spread = F.avg_pool1d(F.max_pool1d(flat, 2, stride=1, padding=1), 2, stride=1)[:, 0].view_as(weights)
    share = spread[..., 1:-1] + 0.01 + 1e-5  # Nowhere zero: what the coarse samples missed may still be found.
    cumulative = F.pad((share / share.sum(dim=-1, keepdim=True)).cumsum(dim=-1), (1, 0))
    edges = 0.5 * (depths[..., 1:] + depths[..., :-1])
    above = torch.searchsorted(cumulative, quantile.contiguous(), right=True).clamp(1, share.shape[-1])
    low, high = cumulative.gather(-1, above - 1), cumulative.gather(-1, above)
    start, end = edges.gather(-1, above - 1), edges.gather(-1, above)
    return start + (quantile - low) / (high - low) * (end - start)


def raw_in_box(field: RawDensity, points: Tensor) -> Tensor:
    """Raw densities at points (B, R, S, 3); outside of the box so low that an interval with such an end is empty."""
    raw = field(points.flatten(1, 2)).view(points.shape[:-1])
    return torch.where((points.abs() <= 1.0).all(dim=-1), raw, torch.finfo(raw.dtype).min / 3.0)


def interval_weights(raw: Tensor, depths: Tensor) -> Tensor:
    """(..., S - 1): transmittance up to an interval times its opacity, from raw densities and distances (..., S)."""
    density = F.softplus(0.5 * (raw[..., 1:] + raw[..., :-1]) - 1.0)
    thickness = density * (depths[..., 1:] - depths[..., :-1])  # Optical.
    before = F.pad(thickness.cumsum(dim=-1), (1, 0))[..., :-1]
    return torch.exp(-before) * -torch.expm1(-thickness)  # A product of transmittances would lose its gradient.


def expected_depth(depths: Tensor, weights: Tensor) -> Tensor:
    """(...): distances (..., S) weighted by those of the intervals between them; not divided by the opacity."""
    return (weights * 0.5 * (depths[..., 1:] + depths[..., :-1])).sum(dim=-1)


def outward_normal(field: RawDensity, points: Tensor) -> Tensor:
    """(B, P, 3) down the gradient of the raw density at points (B, P, 3), by the differences over a tetrahedron.

    A gradient by differentiation would have to be differentiated again, which sampled planes do not offer.
    """
    corners = points.new_tensor([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    around = points[:, None] + NORMAL_STEP * corners[:, None]  # (B, 4, P, 3)
    raw = field(around.flatten(1, 2)).view(around.shape[:-1])
    down = -torch.einsum("bcp,ck->bpk", raw, corners) / (4.0 * NORMAL_STEP)
    return down / (down.square().sum(dim=-1, keepdim=True) + _FLAT**2).sqrt()
