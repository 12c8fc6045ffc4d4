"""What no network is needed for: the hull with the views' colours, and our shape with the views blended onto it."""

from dataclasses import dataclass, replace

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from arm_blender.graphics.cameras import project, view_directions
from arm_blender.graphics.meshes import vertex_normals
from arm_blender.structures import RelightableAsset, TriangleMesh, ViewSet
from arm_blender.uv.backproject import BackprojectConfig, backproject
from arm_blender.uv.blend import BlendConfig, blend
from arm_blender.uv.maps import diffuse_fill, pad
from arm_blender.uv.texels import texel_map
from arm_blender.uv.view_sampling import sample_view
from arm_blender.uv.visibility import DepthBuffer, unoccluded

from .hull_mesh import visual_hull


@dataclass(frozen=True)
class ColoredMesh:
    """A mesh with a colour at every vertex, and one finish.

    Attributes:
        mesh: in the cameras' frame.
        colors: (N, 3) linear, the light of the views included.
        roughness, metallic: of all of it, in [0, 1].
    """

    mesh: TriangleMesh
    colors: Tensor
    roughness: float
    metallic: float


@torch.no_grad()
def colored_hull(views: ViewSet, resolution: int, finish: tuple[float, float]) -> ColoredMesh:
    """The visual hull with the blended colours of the views at its vertices.

    Args:
        resolution: grid samples a side.
        finish: roughness and metallic.
    Raises:
        EmptyMeshError: the masks do not meet.
    """
    hull = visual_hull(views, resolution)
    return ColoredMesh(hull, vertex_colors(hull, views), *finish)


@torch.no_grad()
def vertex_colors(mesh: TriangleMesh, views: ViewSet) -> Tensor:
    """(N, 3) linear: the views that see a vertex, weighted by how squarely they do; unseen ones take the nearest's."""
    config, power = BackprojectConfig(), BlendConfig().cosine_power
    points, normals = mesh.vertices, vertex_normals(mesh.vertices, mesh.faces)
    total = points.new_zeros(4, len(points))
    for image, camera in zip(views.images, views.cameras, strict=True):
        buffer = DepthBuffer.of(mesh, camera, config.depth_resolution, config.margin * camera.height)
        cosine = (normals * view_directions(points, camera)).sum(dim=1)
        free, _ = unoccluded(points, normals, buffer, config.depth_bias, config.slope_bias, config.min_cosine)
        seen = free & (cosine > config.min_cosine)
        color, found = sample_view(image, project(points[seen], camera)[0], cosine.new_ones(int(seen.sum())), 0.5)
        weight = torch.where(found, cosine[seen] ** power, 0.0)
        total[:, seen] += torch.cat([color * weight, weight[None]])
    known = total[3] > 0.0
    if not bool(known.any()):
        return torch.full_like(points, 0.5)
    colors = (total[:3] / total[3].clamp(min=1e-12)).T
    nearest = cKDTree(points[known].numpy()).query(points.numpy())[1]
    return colors[known][torch.from_numpy(nearest)]


@torch.no_grad()
def plain_blend(asset: RelightableAsset, views: ViewSet) -> RelightableAsset:
    """The asset with the blended views for its albedo: nothing takes their light out of it.

    Args:
        asset: in the frame of the views.
    """
    texels = texel_map(asset.mesh, asset.maps.albedo.shape[-1])
    seen = backproject(asset.mesh, texels, views)
    colors, weight = blend(seen, views.weights)
    filled = diffuse_fill(colors, (weight > 0.0) & texels.mask, texels)
    return replace(asset, maps=replace(asset.maps, albedo=pad(filled, texels.mask)))
