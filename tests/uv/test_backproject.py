"""Back-projection of renders whose texture is known."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from arm_blender.graphics.cameras import Camera, orbit_camera, project
from arm_blender.graphics.raster.rasterize import interpolate, rasterize
from arm_blender.structures import TexelMap, UvMesh, ViewSet
from arm_blender.uv.backproject import backproject, texture_size_for
from arm_blender.uv.blend import blend
from arm_blender.uv.texels import texel_map
from arm_blender.views.rigs import zero123plus_rig


def boxes(*placed: tuple[tuple[float, float, float], float]) -> UvMesh:
    """Axis-aligned cubes (centre, half side); every side is a square chart of its own with a gap around."""
    corner = torch.tensor([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    quads = torch.tensor([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    vertices = torch.cat([torch.tensor(center) + half * corner for center, half in placed])
    quads = torch.cat([quads + 8 * index for index in range(len(placed))])
    # Vertices are not shared between sides, so that their smooth normals are the sides' own.
    vertices = vertices[quads].reshape(-1, 3)
    charts = len(quads)
    side = math.ceil(math.sqrt(charts))
    cell = torch.stack([torch.arange(charts) % side, torch.arange(charts) // side], dim=1)[:, None]
    square = torch.tensor([[0.05, 0.05], [0.95, 0.05], [0.95, 0.95], [0.05, 0.95]])
    first = 4 * torch.arange(charts)[:, None]
    faces = torch.cat([first + torch.tensor([0, 1, 2]), first + torch.tensor([0, 2, 3])])
    return UvMesh(vertices, faces, ((cell + square) / side).reshape(-1, 2), faces, charts)


def wave(points: Tensor) -> Tensor:
    """A smooth texture in space: (3, ...) colours at (3, ...) points."""
    return 0.5 + 0.4 * torch.sin(4.0 * points + torch.tensor([0.0, 1.0, 2.0]).view(3, *[1] * (points.ndim - 1)))


def render(mesh: UvMesh, cameras: list[Camera], texture=wave, background: float = 0.0) -> ViewSet:
    """What the cameras see of a mesh without any lighting, over a coloured but transparent background."""
    images = []
    for camera in cameras:
        fragments = rasterize(mesh.vertices, mesh.faces, camera)
        color = texture(interpolate(mesh.vertices, mesh.faces, fragments))
        color = torch.where(fragments.mask, color, background)
        images.append(torch.cat([color, fragments.mask[None].float()]))
    return ViewSet(torch.stack(images), tuple(cameras), torch.ones(len(cameras)), "render")


def around(size: int) -> list[Camera]:
    """Four cameras that together see every side of a cube, each three of them."""
    places = ((45.0, 35.0), (225.0, 35.0), (135.0, -35.0), (315.0, -35.0))
    return [orbit_camera(azimuth, elevation, 6.0, 30.0, size, size) for azimuth, elevation in places]


def test_texels_lie_where_the_atlas_says() -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 1.0))
    texels = texel_map(mesh, 120)
    assert texels.mask.sum() == 6 * 36**2  # Six squares of 0.9 / 3 a side.
    on_side, normals = texels.position[:, texels.mask], texels.normal[:, texels.mask]
    torch.testing.assert_close(on_side.abs().amax(dim=0), torch.ones(on_side.shape[1]))
    torch.testing.assert_close((on_side * normals).sum(dim=0), torch.ones(on_side.shape[1]), atol=1e-5, rtol=0)
    assert not texels.position[:, ~texels.mask].any() and not texels.normal[:, ~texels.mask].any()
    # The first chart lies at the lower left of the UV square, so in the last rows; its lower left corner is vertex 0.
    row, column = 120 - 3, 2
    torch.testing.assert_close(texels.position[:, row, column], mesh.vertices[0], atol=0.1, rtol=0)
    with pytest.raises(ValueError, match="at least one"):
        texel_map(mesh, 0)


@pytest.mark.parametrize(("view_size", "texture_size"), [(224, 128), (128, 200), (320, 96)])
def test_backprojecting_a_render_recovers_the_texture(view_size: int, texture_size: int) -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 0.9))
    texels = texel_map(mesh, texture_size)
    views = render(mesh, around(view_size))
    color, total = blend(backproject(mesh, texels, views), views.weights)
    seen = total > 0
    assert (seen & texels.mask).sum() > 0.97 * texels.mask.sum() and not seen[~texels.mask].any()
    error = (color - wave(texels.position)).abs().amax(dim=0)[seen]
    # Averaging over a width w takes 0.4 * 4**2 * w**2 / 24 off the crests: 0.008 at two of the coarsest texels.
    assert float(error.mean()) < 0.008 and float(error.max()) < 0.06
    assert torch.equal(color[:, ~seen], torch.zeros_like(color[:, ~seen]))


def test_rendering_the_back_projected_texture_reproduces_the_views() -> None:
    """With the true mesh, to 35 dB: checks of 16 texels a period, in six views that overlap."""
    mesh = boxes(((0.0, 0.0, 0.0), 0.9))

    def fine(points: Tensor) -> Tensor:
        return 0.5 + 0.4 * torch.sin(40.0 * points)

    views = render(mesh, list(zero123plus_rig(distance=6.0, size=512)), fine)
    color, total = blend(backproject(mesh, texel_map(mesh, 1024), views), views.weights)
    squared, count = 0.0, 0
    for image, camera in zip(views.images, views.cameras, strict=True):
        fragments = rasterize(mesh.vertices, mesh.faces, camera)
        u, v = interpolate(mesh.uvs, mesh.face_uvs, fragments)
        grid = torch.stack([2.0 * u - 1.0, 1.0 - 2.0 * v], dim=-1)[None]
        again = torch.nn.functional.grid_sample(
            torch.cat([color, (total > 0)[None].float()])[None], grid, align_corners=False
        )[0]
        seen = fragments.mask & (again[3] > 0.999)
        assert float(seen.sum() / fragments.mask.sum()) > 0.9
        squared += float((again[:3] - image[:3])[:, seen].square().sum())
        count += 3 * int(seen.sum())
    assert -10.0 * math.log10(squared / count) > 35.0


def test_a_white_object_before_black_does_not_darken() -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 0.8))
    views = render(mesh, around(128)[::2], lambda points: torch.ones_like(points), background=0.0)
    for size in (64, 200):
        texels = texel_map(mesh, size)
        color, total = blend(backproject(mesh, texels, views), views.weights)
        assert (total > 0).sum() > 0.7 * texels.mask.sum()
        assert float(color[:, total > 0].min()) > 1.0 - 1e-6


def test_what_a_view_says_has_the_geometry_of_its_camera() -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 0.9))
    texels = texel_map(mesh, 64)
    views = render(mesh, around(96)[:2])
    seen = backproject(mesh, texels, views)
    for view, camera in enumerate(views.cameras):
        visible = seen.visibility[view]
        assert 0.4 < visible.sum() / texels.mask.sum() <= 0.5  # Three sides of six.
        points = texels.position[:, visible].T
        towards = torch.nn.functional.normalize(camera.center - points, dim=1)
        direction = seen.direction(view, texels.position)
        torch.testing.assert_close(direction[:, visible].T, towards, atol=1e-5, rtol=0)
        expected = (towards * texels.normal[:, visible].T).sum(dim=1)
        torch.testing.assert_close(seen.cosine[view][visible], expected, atol=1e-5, rtol=0)
        torch.testing.assert_close(seen.pixels[view][visible], project(points, camera)[0], atol=1e-3, rtol=0)
        for values in (seen.color[view], direction, seen.cosine[view][None]):
            assert not values[:, ~visible].any()


def test_an_occluded_texel_stays_unseen_and_takes_nothing_from_what_hides_it() -> None:
    # A small cube hovers before a large one; seen from the front it hides the middle of the large one's front.
    mesh = boxes(((0.0, 0.3, 0.0), 0.6), ((0.0, -0.7, 0.0), 0.2))
    camera = orbit_camera(0.0, 0.0, 6.0, 30.0, 256, 256)

    def texture(points: Tensor) -> Tensor:
        return torch.where(points[1] < -0.4, 1.0, 0.0).expand(3, *points.shape[1:])

    texels = texel_map(mesh, 160)
    seen = backproject(mesh, texels, render(mesh, [camera], texture))
    front = texels.mask & ((texels.position[1] + 0.3).abs() < 1e-4) & (texels.normal[1] < -0.9)
    reach = texels.position[[0, 2]].abs().amax(dim=0)
    # The shadow of the near cube, by similar triangles: its front at distance 5.1 reaches 0.2, the plane lies at 5.7.
    shadow = 0.2 * 5.7 / 5.1
    assert not seen.visibility[0][front & (reach < shadow)].any()
    clear = front & (reach > shadow + 0.05) & (reach < 0.55)
    assert clear.any() and seen.visibility[0][clear].all()
    assert torch.equal(seen.color[0][:, seen.visibility[0] & front].amax(), torch.tensor(0.0))


def test_a_mesh_that_is_a_pixel_off_takes_no_colour_from_in_front() -> None:
    mesh = boxes(((0.0, 0.3, 0.0), 0.6), ((0.0, -0.7, 0.0), 0.2))
    camera = orbit_camera(0.0, 0.0, 6.0, 30.0, 256, 256)

    def texture(points: Tensor) -> Tensor:
        return torch.where(points[1] < -0.4, 1.0, 0.0).expand(3, *points.shape[1:])

    views = render(mesh, [camera], texture)
    texels = texel_map(mesh, 160)
    front = texels.mask & ((texels.position[1] + 0.3).abs() < 1e-4) & (texels.normal[1] < -0.9)
    shifted = replace(camera, K=camera.K + torch.tensor([[0.0, 0.0, 0.9], [0.0, 0.0, 0.9], [0.0, 0.0, 0.0]]))
    seen = backproject(mesh, texels, replace(views, cameras=(shifted,)))
    assert seen.visibility[0][front].any()
    assert float(seen.color[0][:, front].amax()) < 1e-6


def test_a_black_object_before_white_does_not_leak() -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 0.8))
    cameras = around(128)[::2]
    views = render(mesh, cameras, lambda points: torch.zeros_like(points), background=1.0)
    # A bad matte besides: the outermost ring of the object is half transparent and already mixed with the white.
    alpha = views.images[:, 3:]
    inner = -torch.nn.functional.max_pool2d(-alpha, 3, stride=1, padding=1)
    ring = (alpha - inner) * 0.5
    images = torch.cat([torch.where(alpha > 0, ring, 1.0).expand(-1, 3, -1, -1), alpha - ring], dim=1)
    for size in (64, 200):
        texels = texel_map(mesh, size)
        color, total = blend(backproject(mesh, texels, replace(views, images=images)), views.weights)
        assert (total > 0).sum() > 0.7 * texels.mask.sum()
        assert float(color.max()) == 0.0


def test_a_view_denser_than_the_atlas_is_averaged_not_picked() -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 0.8))
    camera = orbit_camera(0.0, 0.0, 6.0, 30.0, 1024, 1024)
    views = render(mesh, [camera])
    y, x = torch.meshgrid(torch.arange(1024), torch.arange(1024), indexing="ij")
    images = views.images.clone()
    images[0, :3] = ((x // 2 + y // 2) % 2).float()  # Checks of two pixels; one texel covers some twenty.
    texels = texel_map(mesh, 64)
    seen = backproject(mesh, texels, replace(views, images=images))
    assert seen.visibility.any()
    torch.testing.assert_close(
        seen.color[0][:, seen.visibility[0]], torch.full((3, int(seen.visibility.sum())), 0.5), atol=0.06, rtol=0
    )


def test_a_thin_plate_shows_each_view_its_own_side() -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 0.8))
    mesh = replace(mesh, vertices=mesh.vertices * torch.tensor([1.0, 0.01, 1.0]))
    cameras = [orbit_camera(0.0, 10.0, 6.0, 30.0, 160, 160), orbit_camera(180.0, 10.0, 6.0, 30.0, 160, 160)]
    views = render(mesh, cameras, lambda points: (points[1] > 0).float().expand(3, *points.shape[1:]))
    texels = texel_map(mesh, 96)
    color, total = blend(backproject(mesh, texels, views), views.weights)
    for side, value in ((-1.0, 0.0), (1.0, 1.0)):
        texel = (texels.normal[1] * side > 0.9) & (total > 0)
        assert texel.sum() > 500
        assert torch.equal(color[:, texel], torch.full((3, int(texel.sum())), value))


def test_a_grazing_view_counts_only_where_no_other_sees_the_texel() -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 0.8))
    # From 15 degrees the camera stands 0.75 above the top's plane and 5 to 6.6 away: a cosine of .11 to .15.
    cameras = [orbit_camera(0.0, elevation, 6.0, 30.0, 256, 256) for elevation in (15.0, 60.0)]
    views = render(mesh, cameras)
    texels = texel_map(mesh, 96)
    # Not the rim of the top: there neither view is sure, and both are read.
    top = (texels.normal[2] > 0.9) & (texels.position[:2].abs().amax(dim=0) < 0.6)
    alone = backproject(mesh, texels, ViewSet(views.images[:1], views.cameras[:1], torch.ones(1), "alone"))
    grazing = alone.visibility[0] & top
    assert torch.equal(grazing, top) and float(alone.cosine[0][grazing].max()) < 0.2
    both = backproject(mesh, texels, views)
    assert torch.equal(both.visibility[1] & top, top) and not (both.visibility[0] & top).any()


def test_a_texture_is_no_larger_than_the_views_can_fill() -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 1.0))
    # Side by side squares of 0.3 a side for 2 units; a camera at 5 from the side sees 2 * f / 5 pixels of them.
    for size in (320, 640, 1280):
        focal = size / 2 / math.tan(math.radians(15.0))
        exact = 2.0 * focal / 5.0 / 0.3
        cameras = tuple(orbit_camera(a, 0.0, 6.0, 30.0, size, size) for a in (0.0, 90.0, 180.0, 270.0))
        views = ViewSet(torch.zeros(4, 4, size, size), cameras, torch.ones(4), "none")
        found = texture_size_for(mesh, views, 4096)
        assert found & (found - 1) == 0 and exact / 1.5 < found < exact * 1.5
    assert texture_size_for(mesh, views, 1000) == 512
    tiny = tuple(camera.resized(32, 32) for camera in cameras)
    assert texture_size_for(mesh, ViewSet(torch.zeros(4, 4, 32, 32), tiny, torch.ones(4), "none"), 4096) == 256


def test_a_mesh_without_views_in_front_is_not_seen() -> None:
    mesh = boxes(((0.0, 0.0, 0.0), 0.5))
    away = orbit_camera(0.0, 0.0, 3.0, 30.0, 64, 64)
    turned = replace(away, c2w=away.c2w @ torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0])))
    views = ViewSet(torch.ones(1, 4, 64, 64), (turned,), torch.ones(1), "away")
    texels: TexelMap = texel_map(mesh, 32)
    assert not backproject(mesh, texels, views).seen.any()
