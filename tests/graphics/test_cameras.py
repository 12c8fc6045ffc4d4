"""Cameras: projection against closed forms, and what must come back after a round trip."""

import math

import pytest
import torch

from arm_blender.graphics.cameras import Camera, front_on_x, look_at, orbit_camera, project, unproject, view_directions


def test_azimuth_zero_stands_on_minus_y_and_grows_counter_clockwise_from_above():
    front, left = orbit_camera(0, 0, 4, 30, 64, 64), orbit_camera(90, 0, 4, 30, 64, 64)
    assert torch.allclose(front.center, torch.tensor([0.0, -4.0, 0.0]), atol=1e-6)
    assert torch.allclose(left.center, torch.tensor([4.0, 0.0, 0.0]), atol=1e-6)


def test_a_point_above_the_centre_appears_higher_in_the_image():
    camera = orbit_camera(0, 0, 4, 30, 64, 64)
    (x, y), depth = project(torch.tensor([0.0, 0.0, 0.5]), camera)
    focal = 32 / math.tan(math.radians(15))
    assert float(x) == pytest.approx(32.0, abs=1e-4)
    assert float(y) == pytest.approx(32.0 - focal * 0.5 / 4.0, abs=1e-4)
    assert float(depth) == pytest.approx(4.0, abs=1e-5)


def test_world_x_is_to_the_right_seen_from_the_front():
    (x, _), _ = project(torch.tensor([0.5, 0.0, 0.0]), orbit_camera(0, 20, 4, 30, 64, 64))
    assert float(x) > 32.0


@pytest.mark.parametrize("elevation", [-90.0, -10.0, 0.0, 35.0, 90.0])
def test_unproject_undoes_project(elevation):
    camera = orbit_camera(77, elevation, 3, 40, 80, 60)
    points = torch.rand(100, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    assert torch.allclose(unproject(*project(points, camera), camera), points, atol=1e-5)


@pytest.mark.parametrize("eye", [(0.0, -3.0, 1.0), (0.0, 0.0, 2.0), (0.0, 0.0, -2.0), (1.0, 2.0, 3.0)])
def test_look_at_is_rigid_and_right_handed(eye):
    rotation = look_at(torch.tensor(eye))[:3, :3]
    assert torch.allclose(rotation.T @ rotation, torch.eye(3), atol=1e-6)
    assert float(torch.linalg.det(rotation)) == pytest.approx(1.0, abs=1e-5)


def test_resizing_moves_pixels_with_the_image():
    camera = orbit_camera(20, 10, 4, 30, 64, 64)
    points = torch.rand(20, 3, generator=torch.Generator().manual_seed(1)) - 0.5
    pixels, depth = project(points, camera)
    assert torch.allclose(project(points, camera.resized(128, 32))[0], pixels * torch.tensor([2.0, 0.5]), atol=1e-3)
    assert torch.equal(project(points, camera.resized(128, 32))[1], depth)


def test_field_of_view_comes_back_from_the_intrinsics():
    assert orbit_camera(0, 0, 4, 37, 100, 50).fovy == pytest.approx(math.radians(37), abs=1e-6)


def test_view_directions_are_unit_and_point_at_the_camera():
    camera = orbit_camera(0, 0, 4, 30, 64, 64)
    assert torch.allclose(view_directions(torch.zeros(3), camera), torch.tensor([0.0, -1.0, 0.0]), atol=1e-6)


def test_points_turn_with_the_cameras():
    camera = orbit_camera(40.0, 15.0, 3.0, 30.0, 8, 8)
    torch.testing.assert_close(front_on_x(camera.center, dim=-1), front_on_x(camera.c2w, dim=-2)[:3, 3])
    front = torch.tensor([0.0, -1.0, 0.5])
    torch.testing.assert_close(front_on_x(front, dim=-1), torch.tensor([1.0, 0.0, 0.5]))


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="c2w must be"):
        Camera(torch.eye(3), torch.eye(3), 8, 8)
