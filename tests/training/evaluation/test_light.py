"""The score of a predicted light: against closed forms."""

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
import trimesh

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.light.spherical_harmonics import COUNT, WHITE
from arm_blender.structures import TriangleMesh, ViewSet
from training.evaluation.scores.light import irradiance_psnr, seen_normals, true_light


def even(level: float) -> torch.Tensor:
    light = torch.zeros(COUNT, 3)
    light[0] = level * WHITE
    return light


def test_light_that_is_a_tenth_too_bright_has_twenty_decibels():
    normals = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    assert irradiance_psnr(even(0.9), even(0.8), normals) == pytest.approx(20.0, abs=1e-3)
    assert irradiance_psnr(even(0.8), even(0.8), normals) > 100.0


def test_light_from_the_wrong_side_is_wrong_where_the_surface_looks_there():
    found, true = even(0.8), even(0.8)
    found[3], true[3] = 1.0, -1.0
    up, side = torch.tensor([[0.0, 0.0, 1.0]]), torch.tensor([[1.0, 0.0, 0.0]])
    assert irradiance_psnr(found, true, up) > 60.0
    assert irradiance_psnr(found, true, side) < 5.0


def test_a_map_is_read_at_the_exposure_of_the_views(tmp_path):
    pixels = np.full((32, 64, 3), 5.0, np.float32)
    pixels[:, 28:36] = 30.0  # Around +X.
    image = oiio.ImageBuf(oiio.ImageSpec(64, 32, 3, oiio.FLOAT))
    image.set_pixels(oiio.ROI(), pixels)
    assert image.write(str(tmp_path / "sky.exr"))
    light = true_light(tmp_path / "sky.exr", 0.8)
    torch.testing.assert_close(light[0], torch.full((3,), 0.8 * WHITE), atol=1e-3, rtol=0.0)
    assert float(light[3].min()) > 0.2 and float(light[[1, 2]].abs().max()) < 0.01


def test_normals_are_those_that_the_cameras_see():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    surface = TriangleMesh(torch.tensor(ball.vertices).float(), torch.tensor(ball.faces))
    camera = orbit_camera(0.0, 0.0, 4.0, 30.0, 32, 32)
    normals = seen_normals(surface, ViewSet(torch.zeros(1, 4, 32, 32), (camera,), torch.ones(1), "ball"))
    assert bool((normals[:, 1] < 0.3).all()) and float(normals.norm(dim=1).min()) > 0.99  # The camera is at -Y.
