"""A normal map gives the dense surface's normals back to whoever decodes it as renderers do."""

import math

import pytest
import torch
import trimesh
from torch.nn import functional

from arm_blender.graphics.meshes import angle_weighted_normals
from arm_blender.graphics.raster.rasterize import interpolate, rasterize_uv
from arm_blender.graphics.tangents import corner_tangents
from arm_blender.structures import TriangleMesh, UvMesh
from arm_blender.uv.normal_map import bake_normal_map


def grid(cells: int) -> tuple[torch.Tensor, torch.Tensor]:
    """(N, 2) points of the unit square and (F, 3) triangles, counter-clockwise."""
    ticks = torch.linspace(0.0, 1.0, cells + 1)
    points = torch.stack(torch.meshgrid(ticks, ticks, indexing="xy"), dim=-1).reshape(-1, 2)
    row, column = torch.meshgrid(torch.arange(cells), torch.arange(cells), indexing="ij")
    a = (row * (cells + 1) + column).flatten()
    faces = torch.cat([torch.stack([a, a + 1, a + cells + 2], 1), torch.stack([a, a + cells + 2, a + cells + 1], 1)])
    return points, faces


def sheet(cells: int, height) -> TriangleMesh:
    points, faces = grid(cells)
    return TriangleMesh(torch.cat([points, height(points)[:, None]], dim=1), faces)


def wavy(points):
    return 0.01 * (4.0 * math.pi * points[:, 0]).sin()


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_wave_over_a_plane_is_its_slope_along_the_tangent(mirrored):
    """Over a plane whose u grows with x the map is the normal itself; mirrored, red has the other sign."""
    points, faces = grid(2)
    flat = torch.cat([points, torch.zeros(len(points), 1)], dim=1)
    uvs = torch.stack([1.0 - points[:, 0], points[:, 1]], dim=1) if mirrored else points
    baked, share = bake_normal_map(UvMesh(flat, faces, uvs, faces, 1), sheet(128, wavy), 64)
    x = (torch.arange(64) + 0.5) / 64
    slope = 0.01 * 4.0 * math.pi * (4.0 * math.pi * x).cos()
    exact = functional.normalize(torch.stack([-slope, torch.zeros(64), torch.ones(64)]), dim=0)
    expected = exact[:, None].expand(3, 64, 64)
    if mirrored:
        expected = expected.flip(2) * torch.tensor([-1.0, 1.0, 1.0])[:, None, None]
    assert share == 1.0
    torch.testing.assert_close(baked, expected.contiguous(), atol=2e-3, rtol=0.0)


def ball(subdivisions: int) -> UvMesh:
    """A ball whose upper and lower half are charts of their own; one of them is mirrored."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    vertices, faces = torch.from_numpy(sphere.vertices.copy()).float(), torch.from_numpy(sphere.faces.copy()).long()
    upper = vertices[faces].mean(dim=1)[:, 2] > 0.0
    flat = 0.25 + 0.2 * vertices[:, :2]
    return UvMesh(vertices, faces, torch.cat([flat, flat + 0.5]), faces + upper[:, None] * len(vertices), 2)


def decoded(baked: torch.Tensor, mesh: UvMesh) -> torch.Tensor:
    """(P, 3) world normals at the covered texels, as Cycles and MikkTSpace decode: nothing normalised but the sum."""
    fragments = rasterize_uv(mesh.uvs, mesh.face_uvs, baked.shape[-1])
    normals = angle_weighted_normals(mesh.vertices, mesh.faces)
    tangents, sign = corner_tangents(mesh, normals)
    corners = torch.arange(3 * len(mesh.faces)).view(-1, 3)
    normal = interpolate(normals, mesh.faces, fragments)[:, fragments.mask].T
    tangent = interpolate(tangents.reshape(-1, 3), corners, fragments)[:, fragments.mask].T
    bitangent = sign[fragments.face_id[fragments.mask], None] * torch.linalg.cross(normal, tangent)
    x, y, z = baked[:, fragments.mask]
    return functional.normalize(x[:, None] * tangent + y[:, None] * bitangent + z[:, None] * normal)


def test_decoding_gives_the_normals_of_the_dense_surface():
    mesh, dense = ball(2), trimesh.creation.icosphere(subdivisions=5)
    surface = TriangleMesh(torch.from_numpy(dense.vertices.copy()).float(), torch.from_numpy(dense.faces.copy()).long())
    baked, share = bake_normal_map(mesh, surface, 128)
    assert share == 1.0
    fragments = rasterize_uv(mesh.uvs, mesh.face_uvs, 128)
    position = interpolate(mesh.vertices, mesh.faces, fragments)[:, fragments.mask].T
    smooth = interpolate(angle_weighted_normals(mesh.vertices, mesh.faces), mesh.faces, fragments)[:, fragments.mask].T
    # Along the interpolated normal a point of the coarse ball goes to where the dense one has that normal, nearly.
    exact = functional.normalize(position)
    away = 1.0 - (position * functional.normalize(smooth)).sum(dim=1)
    assert float(away.max()) < 0.06
    with_map = (decoded(baked, mesh) * exact).sum(dim=1).clamp(max=1.0).acos().rad2deg()
    without = (functional.normalize(smooth) * exact).sum(dim=1).clamp(max=1.0).acos().rad2deg()
    assert float(with_map.mean()) < 0.25 * float(without.mean())
    assert float(with_map.max()) < 0.5


def test_a_surface_over_itself_is_flat():
    mesh = ball(3)
    baked, share = bake_normal_map(mesh, TriangleMesh(mesh.vertices, mesh.faces), 64)
    assert share > 0.999
    assert float(baked[2].min()) > 0.9999


def test_what_finds_no_dense_surface_is_flat_and_told():
    points, faces = grid(2)
    flat = torch.cat([points, torch.zeros(len(points), 1)], dim=1)
    half = sheet(64, wavy)
    left = half.vertices[half.faces].mean(dim=1)[:, 0] < 0.5
    baked, share = bake_normal_map(
        UvMesh(flat, faces, points, faces, 1), TriangleMesh(half.vertices, half.faces[left]), 32
    )
    assert share == pytest.approx(0.5, abs=0.02)
    assert torch.equal(baked[:, :, 17:], torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 32, 15))
