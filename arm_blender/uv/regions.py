"""An atlas cut into the parts that an artist would give one finish each: a few colours, joined over the surface.

Colours are clustered on a lattice of texels (Ward, "Hierarchical grouping to optimize an objective function", 1963) in
OKLab (Ottosson, "A perceptual color space for image processing", 2020), in which lightness counts less than hue: what
light is left in an albedo is lightness. Then texels agree with their neighbours, across the seams of charts as well
(iterated conditional modes, as in `charts`), and what stays small joins its surroundings.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from ..graphics.connectivity import components, half_edges, manifold_pairs
from ..graphics.meshes import face_areas, signed_areas
from ..graphics.raster.rasterize import rasterize_uv
from ..knobs.finishes import MOST_REGIONS
from ..structures import MaterialMaps, Regions, UvMesh
from .maps import pad


@dataclass(frozen=True)
class RegionConfig:
    """What counts as a region. All colours are in OKLab with its lightness times `lightness`."""

    most: int = MOST_REGIONS
    """Regions at most."""
    lattice: int = 256
    """Nodes a side. More cost time; fewer lose what is narrow."""
    lightness: float = 0.45
    """Larger cuts surfaces where shadow is left in their albedo; smaller joins black parts to white ones."""
    apart: float = 0.07
    """Colours nearer than this are one. Smaller cuts a surface at its shades; larger loses parts of a like colour."""
    worth: float = 4e-4
    """What two clusters have to lose by being one, of the surface's share times the square of a distance. Smaller keeps
    small parts, and patterns."""
    sharp: float = 0.35
    """Share of the way from one colour to the other that is gone within `step` nodes where two parts meet. Where it is
    less there is a gradient, and the two are one. Larger joins parts with soft borders."""
    step: int = 4
    """Nodes; larger than the blur of a border, smaller than a gradient."""
    smooth: float = 0.004
    """What one neighbour of another region costs, as the square of a distance. Larger rounds corners and eats lines."""
    sweeps: int = 8
    """Of agreeing with neighbours."""
    island: float = 0.003
    """Share of the surface below which a patch joins its surroundings."""
    least: float = 0.01
    """Share below which a region, all its patches together, does."""


_MOST_BINS = 256
"""Of colours, before any are joined; what that takes grows with the third power."""


@dataclass(frozen=True)
class _Lattice:
    """The covered nodes: (P, 3) colours, (P,) shares of the surface, (E, 2) neighbours; (S, S) node of each cell or -1;
    and which cells a chart covers, (S, S)."""

    color: Tensor
    share: Tensor
    neighbours: Tensor
    node: Tensor
    mask: Tensor


@torch.no_grad()
def regions_of(mesh: UvMesh, maps: MaterialMaps, mask: Tensor, config: RegionConfig = RegionConfig()) -> Regions:
    """The regions of a surface; the same maps give the same regions.

    Args:
        mesh: with its atlas.
        maps: of it, padded; only albedo and baked colour are read.
        mask: (T, T) bool, the covered texels.
    Returns:
        1 to `config.most` regions; one where the surface has one colour.
    """
    device, mesh, maps, mask = mask.device, mesh.to("cpu"), maps.to("cpu"), mask.cpu()  # It is short there.
    lattice = _lattice(mesh, maps.albedo, mask, config)
    if lattice is None:  # No texel is covered.
        return Regions(torch.ones_like(mask, dtype=torch.uint8, device=device), (1.0,), ((0.5, 0.5, 0.5),))
    label = _clusters(lattice, config)
    label = _joined(_agreed(lattice, label, config), lattice, config)
    label = _by_area(label, lattice.share)
    count = int(label.max()) + 1
    area = lattice.share.double().new_zeros(count).index_add_(0, label, lattice.share.double())
    area = area / area.sum()
    index = _upsampled(label, lattice, maps.albedo, config)
    swatch = []
    for number in range(count):
        inside = mask & (index == number + 1)
        inside = inside if inside.any() else index == number + 1
        swatch.append(maps.albedo[:, inside].mean(dim=1) if inside.any() else maps.albedo.flatten(1).mean(dim=1))
    bright, plain = maps.baked[:, mask].mean(dim=1), maps.albedo[:, mask].mean(dim=1)
    light = (bright.clamp(min=1e-3) / plain.clamp(min=1e-3)).tolist()
    return Regions(
        index, tuple(area.tolist()), tuple((r, g, b) for r, g, b in map(Tensor.tolist, swatch)), tuple(light)
    )


def perceived(linear: Tensor, lightness: float) -> Tensor:
    """(P, 3) OKLab of (3, P) linear Rec.709, its lightness times `lightness`."""
    cones = linear.new_tensor(
        [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566],
         [0.0883024619, 0.2817188376, 0.6299787005]]
    )  # fmt: skip
    lab = linear.new_tensor(
        [[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099],
         [0.0259040371, 0.7827717662, -0.8086757660]]
    )  # fmt: skip
    found = lab @ (cones @ linear.clamp(min=0.0)).clamp(min=0.0) ** (1.0 / 3.0)
    return (found * found.new_tensor([lightness, 1.0, 1.0])[:, None]).T


def _lattice(mesh: UvMesh, albedo: Tensor, mask: Tensor, config: RegionConfig) -> _Lattice | None:
    size = min(config.lattice, len(mask))
    fragments = rasterize_uv(mesh.uvs, mesh.face_uvs, size)
    weight = functional.adaptive_avg_pool2d(mask[None].to(albedo), size)
    color = functional.adaptive_avg_pool2d(albedo * mask, size) / weight.clamp(min=1e-6)
    covered = fragments.mask & (weight[0] > 0.0)
    if not covered.any():
        return None
    node = torch.full_like(fragments.face_id, -1)
    node[covered] = torch.arange(int(covered.sum()), device=node.device)
    density = face_areas(mesh.vertices, mesh.faces) / signed_areas(mesh.uvs, mesh.face_uvs).abs().clamp(min=1e-12)
    area = density[fragments.face_id[covered]]
    sides = [torch.stack([node[:, :-1], node[:, 1:]], -1), torch.stack([node[:-1], node[1:]], -1)]
    links = torch.cat([*(pair[(pair >= 0).all(dim=-1)] for pair in sides), _across_seams(mesh, node, covered)])
    share = area / area.sum().clamp(min=1e-12)
    return _Lattice(perceived(color[:, covered], config.lightness), share, links, node, covered)


def _across_seams(mesh: UvMesh, node: Tensor, covered: Tensor) -> Tensor:
    """(E, 2) nodes on both sides of the edges at which charts are cut."""
    corners = half_edges(mesh.face_uvs)
    pairs = manifold_pairs(mesh.faces)
    one, other = corners[pairs[:, 0]], corners[pairs[:, 1]].flip(1)
    cut = (one != other).any(dim=1)
    if not cut.any():
        return pairs[:0]
    one, other = mesh.uvs[one[cut]], mesh.uvs[other[cut]]  # (E, 2 ends, 2)
    size = len(node)
    steps = max(1, min(32, int((one[:, 0] - one[:, 1]).abs().amax() * size) + 1))
    along = ((torch.arange(steps, device=one.device) + 0.5) / steps)[None, :, None]
    nearest = pad(node[None].float(), covered)[0].long()

    def at(ends: Tensor) -> Tensor:
        place = ends[:, :1] + along * (ends[:, 1:] - ends[:, :1])
        column, row = (place * place.new_tensor([size, -size]) + place.new_tensor([0.0, size])).long().unbind(-1)
        return nearest[row.clamp(0, size - 1), column.clamp(0, size - 1)].flatten()

    key = torch.unique(at(one) * int(node.max() + 1) + at(other))
    return torch.stack([key // int(node.max() + 1), key % int(node.max() + 1)], dim=1)


def _clusters(lattice: _Lattice, config: RegionConfig) -> Tensor:
    """(P,) int64: clusters of colour, 0, 1, ...; gradients are not cut."""
    width, count = 0.5 * config.apart, _MOST_BINS + 1
    while count > _MOST_BINS:
        width *= 1.25
        cell = (lattice.color / width).round().long() + 512
        _, bin_of = torch.unique((cell[:, 0] * 1024 + cell[:, 1]) * 1024 + cell[:, 2], return_inverse=True)
        count = int(bin_of.max()) + 1
    weight = lattice.share.new_zeros(count).index_add_(0, bin_of, lattice.share).double()
    total = lattice.color.new_zeros(count, 3).index_add_(0, bin_of, lattice.color * lattice.share[:, None]).double()
    group = torch.arange(count, device=bin_of.device)
    alive = weight > 0.0
    center = total / weight.clamp(min=1e-15)[:, None]
    distance = torch.cdist(center, center)
    others = ~torch.eye(count, dtype=torch.bool, device=alive.device)
    while int(alive.sum()) > 1:
        # What is lost by joining two clusters. Beyond that only what is near, or goes over into the other, is joined.
        loss = distance**2 * weight[:, None] * weight / (weight[:, None] + weight).clamp(min=1e-15)
        loss = torch.where(alive[:, None] & alive & others, loss, torch.inf)
        a, b = divmod(int(loss.argmin()), count)
        few = int(alive.sum()) <= config.most
        if few and float(loss[a, b]) >= config.worth and float(distance[a, b]) >= config.apart:
            near = torch.where(alive[:, None] & alive & others, distance, torch.inf)
            a, b = divmod(int(near.argmin()), count)
            if float(near[a, b]) >= config.apart:
                soft = _gradients(lattice, group[bin_of], center, config)
                found = (soft & alive[:, None] & alive).nonzero()
                if not len(found):
                    break
                a, b = found[loss[found[:, 0], found[:, 1]].argmin()].tolist()
        center[a] = (weight[a] * center[a] + weight[b] * center[b]) / (weight[a] + weight[b])
        weight[a] = weight[a] + weight[b]
        alive[b] = False
        group[group == b] = a
        distance[a] = distance[:, a] = (center - center[a]).norm(dim=1)
    return torch.unique(group[bin_of], return_inverse=True)[1]


def _gradients(lattice: _Lattice, label: Tensor, center: Tensor, config: RegionConfig) -> Tensor:
    """(K, K) bool: clusters that go over into each other where they meet, without a step."""
    count, step = len(center), config.step
    change, met = center.new_zeros(count * count), center.new_zeros(count * count)
    for first, second in (
        (lattice.node[:, :-step], lattice.node[:, step:]),
        (lattice.node[:-step], lattice.node[step:]),
    ):
        both = (first >= 0) & (second >= 0)
        p, q = first[both], second[both]
        apart = label[p] != label[q]
        p, q = p[apart], q[apart]
        way = center[label[q]] - center[label[p]]
        gone = ((lattice.color[q] - lattice.color[p]) * way).sum(1) / way.square().sum(1).clamp(min=1e-12)
        low, high = torch.minimum(label[p], label[q]), torch.maximum(label[p], label[q])
        change.index_add_(0, low * count + high, gone)
        met.index_add_(0, low * count + high, torch.ones_like(gone))
    soft = (met > 0) & (change < config.sharp * met)
    soft = soft.view(count, count)
    return soft | soft.T


def _agreed(lattice: _Lattice, label: Tensor, config: RegionConfig) -> Tensor:
    """(P,) labels that follow colours and neighbours both."""
    count = int(label.max()) + 1
    total = lattice.color.new_zeros(count, 3).index_add_(0, label, lattice.color * lattice.share[:, None])
    center = total / lattice.share.new_zeros(count).index_add_(0, label, lattice.share).clamp(min=1e-12)[:, None]
    # No cost beyond what parts two regions: a spot of dirt is not worth more than a neighbour.
    cost = torch.cdist(lattice.color, center).square().clamp(max=4.0 * config.smooth)
    cost.scatter_(1, label[:, None], cost.amin(dim=1, keepdim=True))  # A gradient stays with its cluster.
    this, other = torch.cat([lattice.neighbours, lattice.neighbours.flip(1)]).unbind(dim=1)
    generator = torch.Generator().manual_seed(0)
    for _ in range(config.sweeps):
        agreement = torch.zeros_like(cost).index_put_(
            (this, label[other]), cost.new_tensor(config.smooth), accumulate=True
        )
        # Not all at once: neighbours that change together would change back together.
        moving = (torch.rand(len(label), generator=generator) < 0.6).to(label.device)
        label = torch.where(moving, (cost - agreement).argmin(dim=1), label)
    return label


def _joined(label: Tensor, lattice: _Lattice, config: RegionConfig) -> Tensor:
    """(P,) labels in which small patches, and small regions, have joined their surroundings."""
    for _ in range(4):
        same = label[lattice.neighbours[:, 0]] == label[lattice.neighbours[:, 1]]
        patch = components(lattice.neighbours[same], len(label))
        patches = int(patch.max()) + 1
        size = lattice.share.new_zeros(patches).index_add_(0, patch, lattice.share)
        count = int(label.max()) + 1
        whole = lattice.share.new_zeros(count).index_add_(0, label, lattice.share)
        if int((whole > 0).sum()) < 2:
            break
        small = (size < config.island) | (whole[label.new_zeros(patches).scatter_(0, patch, label)] < config.least)
        links = lattice.neighbours[~same]
        this, other = torch.cat([links, links.flip(1)]).unbind(dim=1)
        met = size.new_zeros(patches, count).index_put_(
            (patch[this], label[other]), size.new_tensor(1.0), accumulate=True
        )
        met[:, whole < config.least] *= 1e-3  # Rather to a region that stays.
        joins = small & (met.sum(dim=1) > 0)
        if not joins.any():
            break
        label = torch.where(joins[patch], met.argmax(dim=1)[patch], label)
    return torch.unique(label, return_inverse=True)[1]


def _by_area(label: Tensor, share: Tensor) -> Tensor:
    """Labels numbered by their area, the largest first; of equals the one whose first node comes first."""
    count = int(label.max()) + 1
    area = share.double().new_zeros(count).index_add_(0, label, share.double())
    first = torch.full_like(area, len(label)).scatter_reduce(0, label, torch.arange(len(label)).to(area), "amin")
    order = sorted(range(count), key=lambda number: (-float(area[number]), float(first[number])))
    return torch.argsort(torch.tensor(order, device=label.device))[label]


def _upsampled(label: Tensor, lattice: _Lattice, albedo: Tensor, config: RegionConfig) -> Tensor:
    """(T, T) uint8, 1 to N, of every texel: beside a border the region of its own colour, if that is near."""
    size, texels = len(lattice.node), albedo.shape[-1]
    plane = torch.zeros_like(lattice.node)
    plane[lattice.node >= 0] = label + 1
    plane = pad(plane[None].float(), lattice.mask)
    coarse = functional.interpolate(plane[None], size=(texels, texels), mode="nearest")[0, 0].to(torch.uint8)
    if size == texels:
        return coarse
    count = int(label.max()) + 1
    numbers = torch.arange(1, count + 1, device=plane.device)
    near = functional.max_pool2d((plane == numbers[:, None, None]).float()[None], 3, 1, 1)[0]  # (N, S, S)
    border = functional.interpolate((near.sum(0) > 1).float()[None, None], size=(texels, texels))[0, 0] > 0
    rows, columns = border.nonzero(as_tuple=True)
    if not len(rows):
        return coarse
    center = lattice.color.new_zeros(count, 3).index_add_(0, label, lattice.color)
    center = center / torch.bincount(label, minlength=count)[:, None]
    distance = torch.cdist(perceived(albedo[:, rows, columns], config.lightness), center)
    there = near[:, (rows * size) // texels, (columns * size) // texels].T > 0
    coarse[rows, columns] = (torch.where(there, distance, torch.inf).argmin(dim=1) + 1).to(torch.uint8)
    return coarse
