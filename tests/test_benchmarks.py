"""What the benchmarks measure with: known atlases have known numbers, and the plain way agrees with ours."""

import math
from pathlib import Path

import pytest
import torch

from arm_blender.graphics.raster.rasterize import rasterize_uv
from arm_blender.structures import UvMesh
from benchmarks.atlas_quality import atlas_quality
from benchmarks.bench_isosurface import hausdorff_cells
from benchmarks.bench_paper import Stages
from benchmarks.bench_rasterize import bounding_boxes
from benchmarks.measure import PeakMemory, machine
from benchmarks.shapes import wavy_ball

SQUARE = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
FACES = torch.tensor([[0, 1, 2], [0, 2, 3]])


def square(width: float, height: float, apart: float = 0.0) -> UvMesh:
    """A unit square laid out as `width` x `height`; its second face `apart` from the first, as a chart of its own."""
    uvs = SQUARE[:, :2] * torch.tensor([width, height])
    face_uvs = FACES
    if apart:
        uvs, face_uvs = torch.cat([uvs, uvs + torch.tensor([apart, 0.0])]), torch.stack([FACES[0], FACES[1] + 4])
    return UvMesh(SQUARE, FACES, uvs, face_uvs, 2 if apart else 1)


def test_a_square_in_one_piece_has_no_seam_and_no_stretch():
    quality = atlas_quality(square(0.5, 0.5))
    assert quality.charts == 1 and quality.seams == 0.0 and quality.slivers == 0.0
    assert quality.stretch == pytest.approx(1.0) and quality.utilisation == pytest.approx(0.25)


def test_the_seam_of_a_square_cut_in_two_is_its_diagonal():
    quality = atlas_quality(square(0.4, 0.4, apart=0.5))
    assert quality.charts == 2 and quality.seams == pytest.approx(math.sqrt(2.0))


def test_a_square_twice_as_wide_as_high_is_stretched():
    # Singular values sqrt(2) and 1 / sqrt(2) at equal area: their squares' mean is 5 / 4.
    assert atlas_quality(square(0.8, 0.4)).stretch == pytest.approx(math.sqrt(1.25))


def test_a_thin_chart_is_a_sliver():
    quality = atlas_quality(square(0.5, 3.0 / 1024))
    assert quality.slivers == 1.0 and quality.sliver_area == 1.0


def test_bounding_boxes_find_the_faces_that_ours_finds():
    generator = torch.Generator().manual_seed(0)
    corners = torch.rand(30, 1, 2, generator=generator) + 0.2 * torch.rand(30, 3, 2, generator=generator)
    turn = (corners[:, 1] - corners[:, 0])[:, 0] * (corners[:, 2] - corners[:, 0])[:, 1]
    turn = turn - (corners[:, 1] - corners[:, 0])[:, 1] * (corners[:, 2] - corners[:, 0])[:, 0]
    corners = torch.where((turn > 0)[:, None, None], corners, corners.flip(1)) / 1.3
    for corner in corners:
        ours = rasterize_uv(corner, torch.tensor([[0, 1, 2]]), 64).mask
        boxes = bounding_boxes(corner, torch.tensor([[0, 1, 2]]), 64).flip(0) >= 0
        assert int((ours != boxes).sum()) <= 1


def test_the_distance_of_a_moved_mesh_is_counted_in_cells():
    mesh = wavy_ball(500)
    moved = type(mesh)(mesh.vertices + torch.tensor([0.001, 0.0, 0.0]), mesh.faces)
    assert hausdorff_cells(mesh, mesh, 65) == 0.0
    assert hausdorff_cells(mesh, moved, 65) == pytest.approx(0.032, rel=0.01)


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="Linux alone counts anew")
def test_the_peak_of_memory_is_that_since_the_last_reset():
    memory = PeakMemory()
    memory.reset()
    before = memory.gib()
    block = torch.ones(2**26)
    assert memory.gib() - before == pytest.approx(0.25, abs=0.02)
    del block
    memory.reset()
    assert memory.gib() - before < 0.02


def test_each_message_is_a_stage_until_the_next_one(monkeypatch):
    now = iter([2.0, 5.0])
    monkeypatch.setattr("benchmarks.bench_paper.time.perf_counter", lambda: next(now))
    stages = Stages(start=0.0)
    for message in ("sampling", "sampling", "sampling", "marching"):
        stages(0.5, message)
    assert [(stage.name, stage.seconds) for stage in stages.rows] == [("the views", 2.0), ("sampling", 3.0)]


def test_the_machine_is_stated():
    assert "cores" in machine() and "torch" in machine()
