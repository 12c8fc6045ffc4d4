"""Gradients of pictures against finite differences in float64, and anti-aliased areas against exact ones."""

import math

import pytest
import torch
from torch import Tensor

from arm_blender.graphics.cameras import Camera, orbit_camera
from arm_blender.graphics.raster.differentiable import antialias, with_gradient
from arm_blender.graphics.raster.rasterize import interpolate, rasterize

SIZE = 40


@pytest.fixture
def camera() -> Camera:
    camera = orbit_camera(20.0, 15.0, 4.0, 40.0, SIZE, SIZE)
    return Camera(camera.c2w.double(), camera.K.double(), SIZE, SIZE)


def octahedron(scale: float = 0.8) -> tuple[Tensor, Tensor]:
    vertices = torch.tensor([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]).double() * scale
    equator = [0, 2, 1, 3]
    faces = [[equator[i], equator[(i + 1) % 4], 4] for i in range(4)]
    faces += [[equator[(i + 1) % 4], equator[i], 5] for i in range(4)]
    return vertices, torch.tensor(faces)


def square(half: float) -> tuple[Tensor, Tensor]:
    """A square in the plane y = 0, seen from the front by a camera of azimuth and elevation 0."""
    corners = [[-half, 0, -half], [half, 0, -half], [half, 0, half], [-half, 0, half]]
    return torch.tensor(corners).double(), torch.tensor([[0, 1, 2], [0, 2, 3]])


def front() -> Camera:
    camera = orbit_camera(0.0, 0.0, 4.0, 40.0, SIZE, SIZE)
    return Camera(camera.c2w.double(), camera.K.double(), SIZE, SIZE)


def test_the_values_are_those_of_the_rasteriser(camera):
    vertices, faces = octahedron()
    fragments = rasterize(vertices, faces, camera)
    again = with_gradient(fragments, vertices, faces, camera)
    torch.testing.assert_close(again.barycentric, fragments.barycentric, atol=1e-4, rtol=0.0)
    torch.testing.assert_close(again.depth, fragments.depth, atol=1e-4, rtol=0.0)
    assert torch.equal(again.face_id, fragments.face_id)


def test_gradients_inside_of_faces_are_those_of_finite_differences(camera):
    vertices, faces = octahedron()
    fragments = rasterize(vertices, faces, camera)
    generator = torch.Generator().manual_seed(0)
    attributes = torch.rand(len(vertices), 3, generator=generator, dtype=torch.float64)
    weight = torch.rand(4, SIZE, SIZE, generator=generator, dtype=torch.float64)

    def total(moved: Tensor, values: Tensor) -> Tensor:
        # The faces that pixels show are held: with them the picture is smooth.
        own = with_gradient(fragments, moved, faces, camera)
        image = interpolate(values, faces, own)
        depth = torch.where(own.mask, own.depth, 0.0)
        return (weight * torch.cat([image, depth[None]])).sum()

    assert torch.autograd.gradcheck(
        total, (vertices.requires_grad_(), attributes.requires_grad_()), eps=1e-6, atol=1e-5, rtol=1e-5
    )


def test_gradients_are_finite_for_faces_edge_on_and_across_the_near_plane():
    camera = front()
    vertices = torch.tensor(
        [[0.0, -1, -1], [0, 1, 0], [0, 0, 1], [-1, -9, -1], [1, -9, -1], [0, 9, 0.5]], dtype=torch.float64
    ).requires_grad_()
    faces = torch.tensor([[0, 1, 2], [3, 4, 5]])
    fragments = rasterize(vertices.detach(), faces, camera)
    assert fragments.mask.any()
    own = with_gradient(fragments, vertices, faces, camera)
    torch.testing.assert_close(own.barycentric.detach(), fragments.barycentric, atol=1e-3, rtol=0.0)
    own.depth[own.mask].sum().backward()
    assert vertices.grad.isfinite().all() and vertices.grad.abs().sum() > 0


@pytest.mark.parametrize("half", [0.41, 0.437, 0.5, 0.533])
def test_a_blended_square_has_its_exact_width_and_height(half):
    vertices, faces = square(half)
    camera = front()
    fragments = rasterize(vertices, faces, camera)
    image = antialias(fragments.mask.double()[None], vertices, faces, fragments, camera)
    side = 2.0 * half / 4.0 * float(camera.K[0, 0])
    # Exact between the corners, where two outlines meet in a pixel.
    assert float(image[0, SIZE // 2].sum()) == pytest.approx(side, abs=1e-5)
    assert float(image[0, :, SIZE // 2].sum()) == pytest.approx(side, abs=1e-5)
    assert float(image.sum()) == pytest.approx(side**2, abs=2.0)
    assert float(image.min()) >= 0.0 and float(image.max()) <= 1.0


@pytest.mark.parametrize("angle", [0.1, 0.4, 0.785398, 1.2])
@pytest.mark.parametrize("pieces", [1, 30], ids=["one face a side", "faces narrower than a pixel"])
def test_a_turned_square_has_its_area_and_the_areas_derivative(angle, pieces):
    """Each side a fan of faces, some far narrower than a pixel: it is the outline that counts, not whose it is."""
    turn = torch.tensor([[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, math.cos(angle)]])
    corners = torch.tensor([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) @ turn.T
    share = torch.arange(pieces) / pieces
    rim = torch.cat([torch.lerp(a, b, share[:, None]) for a, b in zip(corners, corners.roll(-1, 0), strict=True)])
    count = len(rim)
    faces = torch.tensor([[i, (i + 1) % count, count] for i in range(count)])
    half, camera = torch.tensor(0.9, dtype=torch.float64, requires_grad=True), front()
    vertices = half * torch.cat([rim, torch.zeros(1, 3)]).double()
    fragments = rasterize(vertices.detach(), faces, camera)
    area = antialias(fragments.mask.double()[None], vertices, faces, fragments, camera).sum()
    pixels = float(camera.K[0, 0]) / 4.0
    assert float(area.detach()) == pytest.approx((1.8 * pixels) ** 2, rel=0.01)
    (slope,) = torch.autograd.grad(area, half)
    assert float(slope) == pytest.approx(8.0 * 0.9 * pixels**2, rel=0.05)


def test_outlines_have_the_gradient_of_finite_differences(camera):
    vertices, faces = octahedron()
    weight = torch.rand(1, SIZE, SIZE, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def total(moved: Tensor) -> Tensor:
        fragments = rasterize(moved.detach(), faces, camera)
        return (weight * antialias(fragments.mask.double()[None], moved, faces, fragments, camera)).sum()

    moved = vertices.clone().requires_grad_()
    total(moved).backward()
    step = 1e-5
    for vertex, axis in ((0, 2), (2, 0), (4, 2), (4, 0), (5, 1)):
        offset = torch.zeros_like(vertices)
        offset[vertex, axis] = step
        difference = float(total(vertices + offset) - total(vertices - offset)) / (2.0 * step)
        assert float(moved.grad[vertex, axis]) == pytest.approx(difference, rel=1e-3, abs=1e-4)


def test_a_silhouette_is_fitted_from_its_picture_alone(camera):
    vertices, faces = octahedron()
    target_fragments = rasterize(vertices, faces, camera)
    target = antialias(target_fragments.mask.double()[None], vertices, faces, target_fragments, camera)
    scale = torch.tensor(0.6, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.Adam([scale], lr=0.02)
    for _ in range(60):
        fragments = rasterize((scale * vertices).detach(), faces, camera)
        image = antialias(fragments.mask.double()[None], scale * vertices, faces, fragments, camera)
        loss = (image - target).square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert float(scale.detach()) == pytest.approx(1.0, abs=0.01)


def test_edges_within_the_surface_are_not_blended(camera):
    vertices, faces = octahedron()
    fragments = rasterize(vertices, faces, camera)
    image = torch.rand(3, SIZE, SIZE, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    blended = antialias(image, vertices, faces, fragments, camera)
    mask = fragments.mask.double()[None, None]
    inner = torch.nn.functional.max_pool2d(1.0 - mask, 5, stride=1, padding=2)[0, 0] == 0
    assert inner.any() and torch.equal(blended[:, inner], image[:, inner])
