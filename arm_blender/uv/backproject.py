"""Back-projection (ARM, section 5.2): what each view says of each texel, and the blend of it."""

import math
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from ..graphics.cameras import Camera, project, view_directions
from ..graphics.color import srgb_from_linear
from ..graphics.meshes import face_areas, face_normals, signed_areas
from ..graphics.ragged import in_pieces
from ..progress import Progress, silent
from ..structures import TexelMap, TexelViews, UvMesh, ViewSet
from .view_sampling import footprint, sample_view
from .visibility import DepthBuffer, opaque_pixels, unoccluded

SMALLEST_TEXTURE = 256  # Texels a side.
BLEND_CHUNK = 1 << 17  # Texels blended at once; bounds the work space.


@dataclass(frozen=True)
class BackprojectConfig:
    """When a view may speak for a texel."""

    depth_bias: float = 4e-3
    """World units. Larger leaks texture through thin walls; smaller speckles curved surfaces."""
    slope_bias: float = 2.0
    """Pixels of the z-buffer over which a slanted surface may fall; too small stripes slanted surfaces."""
    depth_resolution: int = 640
    """Pixels of the z-buffer's longer side. Fewer blur what hides what; more cost time."""
    min_cosine: float = 0.2
    """Views more grazing than this are ignored where another sees the texel better: there a pixel of error slides far
    along the surface."""
    grazing_cosine: float = 0.1
    """Views more grazing than this are ignored always. Larger leaves flat tops to in-painting; smaller smears."""
    min_alpha: float = 0.9
    """Pixels less opaque than this are background; lower lets the background's colour into the texture."""
    margin: float = 1.0 / 320.0
    """Share of a view's height (a pixel at least) by which mesh and picture may disagree at an outline. Smaller prints
    what is in front onto what is behind, and the reverse; larger leaves more to in-painting."""


@dataclass(frozen=True)
class BlendConfig:
    """How views share a texel."""

    cosine_power: float = 4.0
    """Of n.v in a view's weight. 0 ghosts where views disagree; large values show seams between them."""
    disagreement: float = 0.1
    """Difference in sRGB at which, of three views and more, the weight of one falls to a quarter. Too small drops
    detail at random; too large keeps highlights and ghosts."""
    rounds: int = 3
    """Of finding what the views agree on. Fewer leave a strong outlier its pull."""
    reach: float = 1.0 / 128.0
    """Share of the texture's side over which views take turns. Without it what they show jumps from texel to texel, and
    patches with hard edges stand in every highlight; too large lets a neighbour's outlier through."""


BLENDS: dict[str, BlendConfig] = {
    "robust": BlendConfig(),
    "weighted": BlendConfig(rounds=0),
    "sharpest": BlendConfig(cosine_power=32.0),
}
"""How views that see the same texel are blended: a view that disagrees with the others is voted out; all count by
their angle and weight; or almost only the one that looks most squarely does."""


@torch.no_grad()
def backproject(
    mesh: UvMesh,
    texels: TexelMap,
    views: ViewSet,
    config: BackprojectConfig = BackprojectConfig(),
    progress: Progress = silent,
) -> TexelViews:
    """What each view says of each texel: its colour, where it is seen unoccluded, not grazing, inside the silhouette.

    Close to an outline of its own surface, or grazing, a view is believed only where no view sees the texel better.

    Args:
        mesh: what hides the texels.
        texels: of its atlas.
        views: on the device of the mesh.
        progress: called twice for every view; what it raises passes through.
    """
    size, count = len(texels.mask), len(views.cameras)
    covered = texels.mask.flatten().nonzero()[:, 0]
    points = texels.position.flatten(1)[:, covered].T
    normals = texels.normal.flatten(1)[:, covered].T
    color = points.new_zeros(count, 3, size * size)
    visibility = torch.zeros(count, size * size, dtype=torch.bool, device=points.device)
    cosine = points.new_zeros(count, size * size)
    pixels = points.new_zeros(count, size * size, 2)
    steps, facing, plain, sure = [], [], [], []
    for view, (image, camera) in enumerate(zip(views.images, views.cameras, strict=True)):
        progress(0.8 * view / count, "back-projecting the views")
        where, squarely = in_pieces(partial(_look, camera), points, normals)
        pixels[view].index_copy_(0, covered, where)
        steps.append(footprint(pixels[view].view(size, size, 2), texels.mask).flatten()[covered])
        facing.append(squarely)
        seen, seen_well = _sight(mesh, points, normals, squarely, steps[-1], image, camera, config)
        plain.append(seen)
        sure.append(seen_well)
    sure_of_one = torch.stack(sure).any(dim=0)
    for view, image in enumerate(views.images):
        progress(0.8 + 0.2 * view / count, "back-projecting the views")
        chosen = torch.where(sure_of_one, sure[view], plain[view]).nonzero()[:, 0]
        where = pixels[view, covered[chosen]]
        colors, found = sample_view(image, where, steps[view][chosen], config.min_alpha)
        chosen, colors = chosen[found], colors[:, found]
        color[view].index_copy_(1, covered[chosen], colors)
        visibility[view, covered[chosen]] = True
        cosine[view, covered[chosen]] = facing[view][chosen].clamp(0.0, 1.0)
    square = (count, size, size)
    return TexelViews(
        color.view(count, 3, size, size),
        visibility.view(square),
        torch.stack([camera.center for camera in views.cameras]),
        cosine.view(square),
        pixels.view(*square, 2),
    )


@torch.no_grad()
def blend(seen: TexelViews, weights: Tensor, config: BlendConfig = BlendConfig()) -> tuple[Tensor, Tensor]:
    """One colour a texel: views weighted by the user, by how squarely they look, and by agreement with the others.

    Args:
        seen: V views of T x T texels.
        weights: (V,) >= 0, the user's.
    Returns:
        (3, T, T) linear colour and (T, T) total weight; both 0 where no view of positive weight sees the texel.
    Raises:
        ValueError: not one weight a view.
    """
    if weights.shape != seen.visibility.shape[:1]:
        raise ValueError(f"{len(seen.visibility)} views, weights {tuple(weights.shape)}")
    size = seen.visibility.shape[-1]
    color = seen.color.new_zeros(3, size * size)
    total = seen.color.new_zeros(size * size)
    standing = _standing(seen, weights, config).flatten(1)
    for texel in seen.seen.flatten().nonzero()[:, 0].split(BLEND_CHUNK):
        colors = seen.color.flatten(2)[:, :, texel]  # (V, 3, P)
        trusted = _trusted(seen, weights, texel)
        facing = seen.cosine.flatten(1)[:, texel] * (trusted > 0)
        # Over the squarest view's: a high power of a small cosine would leave nothing to divide by.
        best = facing.amax(dim=0).clamp(min=1e-6)
        share = trusted * (facing / best) ** config.cosine_power * standing[:, texel]
        color[:, texel] = (share[:, None] * colors).sum(dim=0) / share.sum(dim=0).clamp(min=1e-12)
        total[texel] = share.sum(dim=0) * best**config.cosine_power
    return color.view(3, size, size), total.view(size, size)


def texture_size_for(mesh: UvMesh, views: ViewSet, maximum: int) -> int:
    """Texels a side, a power of two, that the views can fill: about one texel for each pixel that shows the surface.

    Args:
        mesh: with its atlas.
        views: posed views of it.
        maximum: the result is no larger than this, nor smaller than 256.
    """
    centers = mesh.vertices[mesh.faces].mean(dim=1)
    normals = face_normals(mesh.vertices, mesh.faces)
    areas = face_areas(mesh.vertices, mesh.faces)
    finest = torch.zeros_like(areas)  # (F,) pixels per world unit in the view that shows most
    for camera in views.cameras:
        depth = project(centers, camera)[1]
        facing = ((normals * view_directions(centers, camera)).sum(dim=1) > 0.0) & (depth > 0.0)
        finest = torch.where(facing, torch.maximum(finest, camera.K[0, 0] / depth.clamp(min=1e-6)), finest)
    charted = float(signed_areas(mesh.uvs, mesh.face_uvs).abs().sum())
    shown = float((finest**2 * areas).sum()) * float(areas.sum()) / max(float(areas[finest > 0].sum()), 1e-12)
    exact = math.sqrt(max(shown, 1.0) / max(charted, 1e-6))
    return max(SMALLEST_TEXTURE, min(1 << round(math.log2(exact)), 1 << (maximum.bit_length() - 1)))


def _look(camera: Camera, points: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """(P, 2) pixels at which a camera has points (P, 3), and (P,) n.v."""
    return project(points, camera)[0], (normals * view_directions(points, camera)).sum(dim=1)


def _sight(
    mesh: UvMesh,
    points: Tensor,
    normals: Tensor,
    facing: Tensor,
    steps: Tensor,
    image: Tensor,
    camera: Camera,
    config: BackprojectConfig,
) -> tuple[Tensor, Tensor]:
    """Points (P, 3) that a view sees, and those that it sees squarely enough and away from any outline; (P,) bool each.

    `facing` (P,) is n.v, and `steps` (P,) are the pixels that a texel covers.
    """
    visible = (facing >= config.grazing_cosine).nonzero()[:, 0]
    margin = max(1.0, config.margin * camera.height)  # Pixels of the view.
    # A colour is read from pixels around the point: one away if bilinear, more from a mip level.
    typical = float(steps[visible].median()) if len(visible) else 1.0
    reach = 1.0 if typical <= 1.0 else 1.5 * typical
    buffer = DepthBuffer.of(mesh, camera, config.depth_resolution, margin + reach)
    opaque = opaque_pixels(image[3], config.min_alpha, math.ceil(margin - 1e-3))

    def sight(index: Tensor) -> tuple[Tensor, Tensor]:
        near = points[index]
        free, inner = unoccluded(
            near, normals[index], buffer, config.depth_bias, config.slope_bias, config.grazing_cosine
        )
        column, row = project(near, camera)[0].long().unbind(dim=1)
        clear = opaque[row.clamp(0, camera.height - 1), column.clamp(0, camera.width - 1)]
        return free, inner & clear & (facing[index] >= config.min_cosine)

    none = torch.zeros_like(facing, dtype=torch.bool)
    free, inner = in_pieces(sight, visible)
    return none.scatter(0, visible, free), none.scatter(0, visible, inner)


def _trusted(seen: TexelViews, weights: Tensor, texel: Tensor) -> Tensor:
    """(V, P) the user's weight of every view at texels (P,); 0 where it sees nothing."""
    return seen.visibility.flatten(1)[:, texel] * weights.to(seen.color)[:, None]


def _standing(seen: TexelViews, weights: Tensor, config: BlendConfig) -> Tensor:
    """(V, T, T) in [0, 1]: how far each view is to be followed at a texel; 0 where it sees nothing.

    How well it agrees with the rest in the mean around the texel, and less near the border of what it sees: where a
    view begins to see, it is hardly followed at first.
    """
    count, size = seen.visibility.shape[:2]
    vote = seen.color.new_zeros(count, size * size)
    for texel in seen.seen.flatten().nonzero()[:, 0].split(BLEND_CHUNK):
        trusted = _trusted(seen, weights, texel)
        vote[:, texel] = _vote(seen.color.flatten(2)[:, :, texel], trusted, config) * (trusted > 0)
    standing = vote.view(count, size, size)
    radius = round(config.reach * size)
    if not radius:
        return standing
    own = seen.visibility & (weights > 0).to(seen.visibility.device)[:, None, None]
    anyone = _around(own.any(dim=0).to(standing), radius).clamp(min=1e-6)
    for view, sees in enumerate(own):
        share = _around(sees.to(standing), radius).clamp(min=1e-6)
        # A half is a straight border. What a view alone sees it is believed in, however narrow.
        inside = (2.0 * share / anyone - 1.0).clamp(min=1e-3)
        standing[view] = sees * inside * _around(standing[view], radius) / share
    return standing


def _around(plane: Tensor, radius: int) -> Tensor:
    """(T, T) mean of `plane` around every texel: two boxes, one after the other, each along rows and columns."""
    side, plane = 2 * radius + 1, plane[None]
    for _ in range(2):
        plane = avg_pool2d(plane, (1, side), stride=1, padding=(0, radius))
        plane = avg_pool2d(plane, (side, 1), stride=1, padding=(radius, 0))
    return plane[0]


def _vote(colors: Tensor, trusted: Tensor, config: BlendConfig) -> Tensor:
    """(V, P) in (0, 1]: how well each view agrees with the rest; 1 where fewer than three see the texel.

    Iteratively reweighted mean with the Geman-McClure weight, started from the plain mean.
    """
    perceived = srgb_from_linear(colors)
    agreement = torch.ones_like(trusted)
    for _ in range(config.rounds):
        share = trusted * agreement
        center = (share[:, None] * perceived).sum(dim=0) / share.sum(dim=0).clamp(min=1e-12)
        difference = (perceived - center).abs().amax(dim=1) / config.disagreement
        agreement = (1.0 + difference**2) ** -2
    return torch.where((trusted > 0).sum(dim=0) >= 3, agreement, 1.0)
