"""The rasteriser against a naive loop in float64 and against closed forms."""

import math

import pytest
import torch
from scipy.spatial import ConvexHull
from torch import Tensor

from arm_blender.graphics.cameras import Camera, orbit_camera, project, unproject
from arm_blender.graphics.raster.rasterize import (
    CHUNK,
    Fragments,
    interpolate,
    rasterize,
    rasterize_uv,
    rasterize_views,
)


def reference(vertices: Tensor, faces: Tensor, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """Intersect the ray of every pixel with every triangle, one after another, in float64.

    Returns:
        face_id (H, W), barycentric (3, H, W), depth (H, W).
    """
    camera = Camera(camera.c2w.double(), camera.K.double(), camera.width, camera.height)
    local = vertices.double() @ camera.w2c[:3, :3].T + camera.w2c[:3, 3]
    y, x = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    ray = torch.stack([
        (x + 0.5 - camera.K[0, 2]) / camera.K[0, 0],
        -(y + 0.5 - camera.K[1, 2]) / camera.K[1, 1],
        -torch.ones(x.shape, dtype=torch.float64),
    ])  # fmt: skip
    face_id = torch.full(x.shape, -1)
    barycentric = torch.zeros(3, *x.shape, dtype=torch.float64)
    depth = torch.full(x.shape, torch.inf, dtype=torch.float64)
    for index, face in enumerate(faces):
        a, b, c = local[face]
        normal = torch.linalg.cross(b - a, c - a)
        t = (normal @ a) / torch.einsum("i,ihw->hw", normal, ray)
        hit = t * ray - a[:, None, None]
        weights = torch.einsum("ij,jhw->ihw", torch.linalg.pinv(torch.stack([b - a, c - a], dim=1)), hit)
        weights = torch.stack([1 - weights[0] - weights[1], weights[0], weights[1]])
        seen = (weights >= 0).all(dim=0) & (t >= 1e-2) & (t < depth)
        face_id[seen], depth[seen] = index, t[seen]
        barycentric[:, seen] = weights[:, seen]
    return face_id, barycentric, depth


def soup(count: int, size: float, seed: int) -> tuple[Tensor, Tensor]:
    """`count` random triangles of about `size` in the box; no two share an edge."""
    generator = torch.Generator().manual_seed(seed)
    centers = torch.rand(count, 1, 3, generator=generator) * 1.6 - 0.8
    vertices = centers + size * (torch.rand(count, 3, 3, generator=generator) - 0.5)
    return vertices.reshape(-1, 3), torch.arange(3 * count).view(count, 3)


def sphere(radius: float, rings: int) -> tuple[Tensor, Tensor]:
    """A closed UV sphere at the origin."""
    theta = torch.linspace(0, math.pi, rings + 1)[:, None]
    phi = torch.arange(2 * rings)[None] * (math.pi / rings)
    vertices = radius * torch.stack([
        theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos().expand(-1, 2 * rings),
    ], dim=-1).reshape(-1, 3)  # fmt: skip
    row, column = torch.meshgrid(torch.arange(rings), torch.arange(2 * rings), indexing="ij")
    a = (row * 2 * rings + column).flatten()
    b = (row * 2 * rings + (column + 1) % (2 * rings)).flatten()
    quads = torch.stack([a, a + 2 * rings, b + 2 * rings, b], dim=1)
    return vertices, torch.cat([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


@pytest.mark.parametrize(("count", "size", "distance"), [(60, 0.7, 4.0), (40, 3.0, 6.0), (200, 0.1, 2.0)])
def test_fast_rasterizer_equals_the_naive_one(count: int, size: float, distance: float) -> None:
    vertices, faces = soup(count, size, seed=count)
    camera = orbit_camera(37.0, 21.0, distance, 40.0, 61, 47)
    fast = rasterize(vertices, faces, camera)
    face_id, barycentric, depth = reference(vertices, faces, camera)
    # Now and then an edge passes within float32 rounding of a pixel centre: there either answer is right.
    same = fast.face_id == face_id
    assert (~same).sum() <= 1
    seen = same & (face_id >= 0)
    assert seen.sum() > 50
    torch.testing.assert_close(fast.depth[seen].double(), depth[seen], rtol=1e-4, atol=0.0)
    # A sliver's coordinates amplify the rounding of its corners, so the point is compared, not the coordinates.
    points = (vertices[faces[face_id]].double() * barycentric.permute(1, 2, 0)[..., None]).sum(dim=2)
    found = interpolate(vertices, faces, fast).permute(1, 2, 0).double()
    torch.testing.assert_close(found[seen], points[seen], rtol=0.0, atol=2e-3)


def test_triangles_across_the_near_plane_equal_the_naive_ones() -> None:
    vertices, faces = soup(30, 4.0, seed=3)
    camera = orbit_camera(10.0, 5.0, 0.6, 60.0, 53, 41)
    behind = (project(vertices, camera)[1] < 0.0)[faces].sum(dim=1)
    assert {1, 2} <= set(behind.tolist())
    fast = rasterize(vertices, faces, camera)
    face_id, _, depth = reference(vertices, faces, camera)
    same = fast.face_id == face_id
    assert same.float().mean() > 0.998
    torch.testing.assert_close(fast.depth[same].double(), depth[same], rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(fast.barycentric.sum(dim=0), fast.mask.float(), rtol=0.0, atol=1e-4)


def test_sphere_has_the_analytic_silhouette_and_depth() -> None:
    radius, distance, size = 0.8, 4.0, 200
    camera = orbit_camera(20.0, 30.0, distance, 35.0, size, size)
    fragments = rasterize(*sphere(radius, 96), camera)
    # The silhouette is the cone tangent to the sphere: a circle around the principal point.
    tangent = radius / math.sqrt(distance**2 - radius**2) * float(camera.K[0, 0])
    assert float(fragments.mask.sum()) == pytest.approx(math.pi * tangent**2, rel=0.005)
    y, x = torch.meshgrid(torch.arange(size) + 0.5, torch.arange(size) + 0.5, indexing="ij")
    slope = ((x - camera.K[0, 2]) ** 2 + (y - camera.K[1, 2]) ** 2).sqrt() / camera.K[0, 0]
    # |d - z| and the lateral offset z * slope lie on the sphere: z**2 (1 + s**2) - 2 d z + d**2 - r**2 = 0.
    root = (distance**2 - (1 + slope**2) * (distance**2 - radius**2)).clamp(min=0).sqrt()
    inner = slope * float(camera.K[0, 0]) < 0.95 * tangent
    torch.testing.assert_close(fragments.depth[inner], ((distance - root) / (1 + slope**2))[inner], atol=2e-3, rtol=0)
    assert torch.isinf(fragments.depth[~fragments.mask]).all()


def test_shared_edges_leave_no_cracks() -> None:
    generator = torch.Generator().manual_seed(0)
    side = 24
    grid = torch.stack(torch.meshgrid(torch.arange(side + 1), torch.arange(side + 1), indexing="xy"), dim=-1) / side
    grid[1:-1, 1:-1] += (torch.rand(side - 1, side - 1, 2, generator=generator) - 0.5) * 0.6 / side
    row, column = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    a = (row * (side + 1) + column).flatten()
    faces = torch.cat([
        torch.stack([a, a + 1, a + side + 2], dim=1), torch.stack([a, a + side + 2, a + side + 1], dim=1)
    ])  # fmt: skip
    assert rasterize_uv(grid.view(-1, 2), faces, 256).mask.all()


@pytest.mark.parametrize("size", [1, 7, 97, 255])
@pytest.mark.parametrize("shift", [0.0, 0.5, 1e-3, 1.0 / 3.0])
def test_a_pixel_on_a_mesh_belongs_to_one_face(size: int, shift: float) -> None:
    """The faces of a grid, drawn one by one, share no pixel but on their edges, and leave none out."""
    line = torch.linspace(0.0, 1.0, 6)
    line = (line + shift / size * torch.tensor([0.0, 1.0, 1.0, 1.0, 1.0, 0.0])).clamp(0.0, 1.0)
    uvs = torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1).reshape(-1, 2)
    row, column = torch.meshgrid(torch.arange(5), torch.arange(5), indexing="ij")
    a = (row * 6 + column).flatten()
    faces = torch.cat([torch.stack([a, a + 1, a + 7], 1), torch.stack([a, a + 7, a + 6], 1)])
    counts = sum(rasterize_uv(uvs, face[None], size).mask.int() for face in faces)
    assert int(counts.min()) >= 1
    center = (torch.arange(size) + 0.5) / size
    x, y = center[None].expand(size, size), 1.0 - center[:, None].expand(size, size)
    within = x[..., None] - line, y[..., None] - line
    # On a grid line, or on a cell's diagonal.
    edge = torch.minimum(within[0].abs().amin(-1), within[1].abs().amin(-1)) < 1e-3 / size
    cell_x, cell_y = ((w >= 0).sum(-1).clamp(1, 5) - 1 for w in within)
    width, height = (line[c + 1] - line[c] for c in (cell_x, cell_y))
    edge |= ((x - line[cell_x]) / width - (y - line[cell_y]) / height).abs() < 1e-2
    assert int(counts[~edge].max() if (~edge).any() else 1) == 1


@pytest.mark.parametrize(("width", "height"), [(1, 1), (7, 13), (61, 47), (255, 3)])
@pytest.mark.parametrize("seed", range(3))
def test_a_random_solid_has_neither_cracks_nor_a_fringe(width: int, height: int, seed: int) -> None:
    """Against the planes that bound a convex solid: a ray meets it where it enters all before it leaves any."""
    corners = torch.randn(40, 3, generator=torch.Generator().manual_seed(seed)).double()
    hull = ConvexHull((corners / corners.norm(dim=1, keepdim=True)).numpy())
    vertices, faces = torch.from_numpy(hull.points).float(), torch.from_numpy(hull.simplices).long()
    camera = orbit_camera(20.0 * seed, 30.0, 3.0, 45.0, width, height)
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    rays = unproject(torch.stack([x, y], dim=-1) + 0.5, torch.ones(height, width), camera).double() - camera.center
    planes = torch.from_numpy(hull.equations)
    speed, distance = rays @ planes[:, :3].T, camera.center.double() @ planes[:, :3].T + planes[:, 3]
    crossing = -distance / speed
    enter = torch.where(speed < 0, crossing, -torch.inf).amax(-1)
    leave = torch.where(speed > 0, crossing, torch.inf).amin(-1)
    fragments = rasterize(vertices, faces, camera)
    clear = (leave - enter).abs() > 1e-3  # Elsewhere the ray grazes an edge.
    assert torch.equal(fragments.mask[clear], (leave > enter)[clear])
    seen = clear & fragments.mask
    torch.testing.assert_close(fragments.depth[seen].double(), enter[seen], rtol=1e-4, atol=0.0)


def test_faces_smaller_than_a_pixel_cover_what_they_are_of() -> None:
    """65,536 faces in a picture of 256 pixels: a ball has no hole."""
    radius, distance, size = 0.8, 4.0, 16
    camera = orbit_camera(20.0, 30.0, distance, 35.0, size, size)
    mask = rasterize(*sphere(radius, 128), camera).mask
    tangent = radius / math.sqrt(distance**2 - radius**2) * float(camera.K[0, 0])
    from_center = (torch.arange(size) + 0.5 - size / 2).square()
    inside = (from_center[:, None] + from_center).sqrt() - tangent
    clear = inside.abs() > 0.02
    assert torch.equal(mask[clear], inside[clear] < 0.0) and int(clear.sum()) > 240


def test_views_at_once_equal_views_one_by_one() -> None:
    vertices, faces = soup(60, 0.7, 3)
    # The second camera stands among the triangles: some cross its near plane.
    cameras = [orbit_camera(30.0 * i, 10.0 * i, d, 50.0, 40, 24) for i, d in enumerate((3.0, 0.3, 5.0))]
    together = rasterize_views(vertices, faces, cameras)
    assert together.face_id.shape == (3, 24, 40) and together.barycentric.shape == (3, 3, 24, 40)
    for i, camera in enumerate(cameras):
        alone = rasterize(vertices, faces, camera)
        assert alone.mask.any()
        assert torch.equal(together[i].face_id, alone.face_id) and torch.equal(together[i].depth, alone.depth)
        assert torch.equal(together[i].barycentric, alone.barycentric)


def test_views_of_several_sizes_are_refused() -> None:
    vertices, faces = soup(2, 0.5, 0)
    with pytest.raises(ValueError, match="one size"):
        rasterize_views(vertices, faces, [orbit_camera(0, 0, 3, 40, 8, 8), orbit_camera(0, 0, 3, 40, 8, 9)])
    with pytest.raises(ValueError, match="no camera"):
        rasterize_views(vertices, faces, [])


def test_depth_stays_within_a_face_seen_edge_on() -> None:
    """Its depth on the screen is as steep as can be: what lies between its corners must not overshoot them."""
    for tilt in (1e-1, 1e-3, 1e-5, 1e-7):
        vertices = torch.tensor([[-0.5, -1.0, 0.0], [0.5, -1.0, 0.0], [0.0, 1.0, tilt]])
        fragments = rasterize(vertices, torch.tensor([[0, 1, 2]]), orbit_camera(0.0, 0.0, 3.0, 40.0, 65, 65))
        depth = fragments.depth[fragments.mask]
        assert bool(((depth >= 2.0 - 1e-5) & (depth <= 4.0 + 1e-5)).all())


def test_winding_does_not_matter_and_the_lowest_face_wins_a_tie() -> None:
    vertices = torch.tensor([[-0.5, 0.0, -0.5], [0.5, 0.0, -0.5], [0.0, 0.0, 0.5]])
    camera = orbit_camera(0.0, 0.0, 3.0, 40.0, 32, 32)
    forward = rasterize(vertices, torch.tensor([[0, 1, 2]]), camera)
    backward = rasterize(vertices, torch.tensor([[2, 1, 0]]), camera)
    assert torch.equal(forward.mask, backward.mask) and forward.mask.any()
    twice = rasterize(vertices, torch.tensor([[0, 1, 2], [0, 1, 2]]), camera)
    assert torch.equal(twice.face_id, forward.face_id)
    behind = rasterize(vertices - torch.tensor([0.0, 9.0, 0.0]), torch.tensor([[0, 1, 2]]), camera)
    assert not behind.mask.any()


def test_screen_larger_than_a_chunk_is_filled() -> None:
    size = 600
    assert size * size > CHUNK
    vertices = torch.tensor([[-99.0, 0.0, -99.0], [99.0, 0.0, -99.0], [0.0, 0.0, 99.0]])
    fragments = rasterize(vertices, torch.tensor([[0, 1, 2]]), orbit_camera(0.0, 0.0, 5.0, 30.0, size, size))
    assert fragments.mask.all()
    torch.testing.assert_close(fragments.depth, torch.full((size, size), 5.0), rtol=1e-4, atol=0.0)


def test_degenerate_input_draws_nothing() -> None:
    camera = orbit_camera(0.0, 0.0, 3.0, 40.0, 8, 8)
    nan = torch.tensor([[float("nan"), 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.5]])
    line = torch.tensor([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.1, 0.0, 0.0]])
    for vertices in (nan, nan * torch.inf, line):
        assert not rasterize(vertices, torch.tensor([[0, 1, 2]]), camera).mask.any()
    assert not rasterize(torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.int64), camera).mask.any()
    with pytest.raises(ValueError, match="expected"):
        rasterize(torch.zeros(3, 2), torch.tensor([[0, 1, 2]]), camera)


def test_atlas_row_zero_is_v_one() -> None:
    uvs = torch.tensor([[0.0, 1.0], [1.0, 1.0], [0.0, 0.5], [1.0, 0.5]])
    fragments = rasterize_uv(uvs, torch.tensor([[0, 1, 2], [1, 3, 2], [0, 1, 2]]), 8)
    assert fragments.mask[:4].all() and not fragments.mask[4:].any()
    assert set(fragments.face_id[:4].flatten().tolist()) == {0, 1}
    uv = interpolate(uvs, torch.tensor([[0, 1, 2], [1, 3, 2], [0, 1, 2]]), fragments)
    expected = torch.stack(torch.meshgrid((torch.arange(8) + 0.5) / 8, 1 - (torch.arange(4) + 0.5) / 8, indexing="xy"))
    torch.testing.assert_close(uv[:, :4], expected, atol=1e-5, rtol=0.0)


def test_interpolation_is_linear_and_differentiable_in_the_attributes() -> None:
    vertices, faces = soup(5, 1.5, seed=1)
    fragments: Fragments = rasterize(vertices, faces, orbit_camera(0.0, 20.0, 4.0, 40.0, 24, 24))
    attributes = torch.ones(len(vertices), 1, requires_grad=True)
    image = interpolate(attributes, faces, fragments)
    torch.testing.assert_close(image[0], fragments.mask.float())
    image.sum().backward()
    assert float(attributes.grad.sum()) == pytest.approx(float(fragments.mask.sum()), rel=1e-4)
