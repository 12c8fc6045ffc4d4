"""Back-projection (ARM, section 5.2): what each view says of each texel."""

import math
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from ..graphics.cameras import Camera, project, view_directions
from ..graphics.meshes import face_areas, face_normals, signed_areas
from ..graphics.ragged import in_pieces
from ..progress import Progress, silent
from ..structures import TexelMap, TexelViews, TriangleMesh, UvMesh, ViewSet
from .view_sampling import footprint, sample_view
from .visibility import DepthBuffer, opaque_pixels, unoccluded

SMALLEST_TEXTURE = 256  # Texels a side.


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
        where, squarely = in_pieces(partial(look, camera), points, normals)
        pixels[view].index_copy_(0, covered, where)
        steps.append(footprint(pixels[view].view(size, size, 2), texels.mask).flatten()[covered])
        facing.append(squarely)
        seen, seen_well = sight(mesh, points, normals, squarely, steps[-1], image, camera, config)
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


def look(camera: Camera, points: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """(P, 2) pixels at which a camera has points (P, 3), and (P,) n.v."""
    return project(points, camera)[0], (normals * view_directions(points, camera)).sum(dim=1)


def sight(
    mesh: TriangleMesh | UvMesh,
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

    def near_and_clear(index: Tensor) -> tuple[Tensor, Tensor]:
        near = points[index]
        free, inner = unoccluded(
            near, normals[index], buffer, config.depth_bias, config.slope_bias, config.grazing_cosine
        )
        column, row = project(near, camera)[0].long().unbind(dim=1)
        clear = opaque[row.clamp(0, camera.height - 1), column.clamp(0, camera.width - 1)]
        return free, inner & clear & (facing[index] >= config.min_cosine)

    none = torch.zeros_like(facing, dtype=torch.bool)
    free, inner = in_pieces(near_and_clear, visible)
    return none.scatter(0, visible, free), none.scatter(0, visible, inner)
