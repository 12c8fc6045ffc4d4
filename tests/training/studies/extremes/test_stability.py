"""The measures behind the document on stability: each sees the error that it is there for."""

from dataclasses import replace

import pytest
import torch

from arm_blender.config import PRESETS, Settings
from arm_blender.graphics.cameras import orbit_camera, project
from arm_blender.graphics.raster.rasterize import rasterize
from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, extract
from arm_blender.models.small.volume_georm import VolumeGeoRMConfig
from arm_blender.structures import TriangleMesh
from arm_blender.weight_files import checkpoints
from training.studies.extremes.ball import RADIUS, VOLUME, ball, open_edges, volume
from training.studies.extremes.precision import NARROW, built, compared, in_three_precisions
from training.studies.extremes.stability import missed_and_outside


def test_a_ball_is_closed_and_has_its_volume_until_a_face_is_taken_away():
    mesh = extract(lambda p: ball(p, 10.0, 0.0), IsosurfaceConfig(48, iso=0.0))
    assert float(ball(torch.tensor([[0.0, 0.0, RADIUS]]), 5.0, 3.0)) == pytest.approx(3.0)
    assert open_edges(mesh) == 0
    assert volume(mesh) == pytest.approx(VOLUME, rel=5e-3)
    assert volume(replace(mesh, faces=mesh.faces.flip(1))) == pytest.approx(-VOLUME, rel=5e-3)
    assert open_edges(TriangleMesh(mesh.vertices, mesh.faces[1:])) == 3


def test_a_sum_that_cancels_is_exact_in_float64_alone():
    x = torch.tensor([0.25, 0.75])
    single, _, exact = in_three_precisions(lambda _, x: x + 1e8 - 1e8, None, x)
    assert torch.equal(exact[0], x.double()) and not single[0].any()
    # Off by 0.75 at most, and 0.25 from the mean.
    assert compared(lambda _, x: x + 1e8 - 1e8, None, x) == ("3.0e+00", "3.0e+00")


def test_bfloat16_rounds_the_inputs_of_a_matrix_product():
    torch.manual_seed(0)
    layer = torch.nn.Linear(1, 1, bias=False)
    torch.nn.init.ones_(layer.weight)
    # 1 + 2**-8 lies half-way between two numbers of bfloat16 and is rounded to the even one, 1.
    x = torch.tensor([[1.0 + 2.0**-8], [0.0]])
    single, half, exact = in_three_precisions(lambda network, x: network(x), layer, x)
    assert torch.equal(single[0], x) and torch.equal(half[0].float(), torch.tensor([[1.0], [0.0]]))
    assert exact[0].dtype == torch.float64
    assert layer.weight.dtype == torch.float32 and torch.get_default_dtype() == torch.float32


def test_pixels_that_are_missed_or_drawn_beside_a_triangle_are_found():
    camera = orbit_camera(0.0, 0.0, 4.0, 30.0, 32, 32)
    vertices = torch.tensor([[-0.8, 0.0, -0.7], [0.7, 0.0, -0.6], [0.1, 0.0, 0.8]])
    fragments = rasterize(vertices, torch.tensor([[0, 1, 2]]), camera)
    screen = project(vertices.double(), replace(camera, c2w=camera.c2w.double(), K=camera.K.double()))[0][None]
    assert missed_and_outside(screen, fragments) == (0, 0.0)
    assert missed_and_outside(screen.flip(1), fragments) == (0, 0.0)
    row, column = fragments.mask.nonzero()[0].tolist()
    hole = replace(fragments, face_id=fragments.face_id.clone())
    hole.face_id[row, column] = -1
    assert missed_and_outside(screen, hole)[0] == 1
    beside = replace(fragments, face_id=torch.zeros_like(fragments.face_id))
    missed, outside = missed_and_outside(screen, beside)
    assert missed == 0 and outside > 5.0


def test_a_network_is_that_which_ships_or_one_that_is_drawn_alike_every_time():
    shipped = checkpoints.load(Settings().weights("georm"), VolumeGeoRMConfig)[1]
    georm = built("georm", PRESETS["small"].georm, shipped=True)
    assert all(torch.equal(value, shipped[name]) for name, value in georm.state_dict().items())
    one, other = (built("instant_albedo", NARROW.instant_albedo, shipped=False).state_dict() for _ in range(2))
    assert one.keys() == other.keys() and all(torch.equal(value, other[name]) for name, value in one.items())
