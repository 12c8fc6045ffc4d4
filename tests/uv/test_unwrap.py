"""Atlases by both methods: no texel twice, nothing outside, the mesh unchanged, the process under control."""

import math
import subprocess

import pytest
import torch
from torch import Tensor

from arm_blender.errors import Cancelled, UnwrapError
from arm_blender.graphics.isosurface import IsosurfaceConfig, extract
from arm_blender.structures import TriangleMesh, UvMesh
from arm_blender.uv import unwrap as unwrap_module
from arm_blender.uv.charts import projection_charts
from arm_blender.uv.decimate import decimate
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

SIZE = 96
LIMITS = {"xatlas": 60.0, "projection": 0.0}


def bumpy_ball() -> TriangleMesh:
    def density(p: Tensor) -> Tensor:
        return 10.0 + 0.6 + 0.05 * torch.sin(9.0 * p).sum(dim=1) - p.norm(dim=1)

    return decimate(extract(density, IsosurfaceConfig(32)), 400)


def spiral_ramp() -> TriangleMesh:
    """A ramp that winds three times around the Z axis: one piece, all of it facing upwards, three layers deep."""
    angle = torch.linspace(0.0, 6.0 * math.pi, 91)
    rim = torch.stack([angle.cos(), angle.sin(), 0.05 * angle], dim=1)
    vertices = torch.cat([rim * torch.tensor([0.4, 0.4, 1.0]), rim])
    inner = torch.arange(90)
    outer = inner + 91
    faces = torch.cat([torch.stack([inner, outer, outer + 1], 1), torch.stack([inner, outer + 1, inner + 1], 1)])
    return TriangleMesh(vertices, faces)


def covering_faces(mesh: UvMesh, size: int) -> Tensor:
    """(T * T, F) bool: which faces hold the centre of which texel strictly inside; every pair is tried."""
    line = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    centers = torch.stack(torch.meshgrid(line, line, indexing="xy"), dim=-1).reshape(-1, 1, 2)
    corners = mesh.uvs.double()[mesh.face_uvs]
    sides = []
    for k in range(3):
        start, end = corners[:, k], corners[:, (k + 1) % 3]
        side, offset = end - start, centers - start
        sides.append(side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0])
    low, high = torch.stack(sides).aminmax(dim=0)
    return (low > 1e-9) | (high < -1e-9)


def uv_areas(mesh: UvMesh) -> Tensor:
    a, b, c = mesh.uvs.double()[mesh.face_uvs].unbind(dim=1)
    return ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2


@pytest.fixture(scope="module", params=["bumpy ball", "spiral ramp"])
def surface(request) -> TriangleMesh:
    return {"bumpy ball": bumpy_ball, "spiral ramp": spiral_ramp}[request.param]()


@pytest.mark.parametrize("method", LIMITS)
def test_an_atlas_covers_no_texel_twice(surface, method):
    mesh, used = unwrap(surface, UnwrapConfig(SIZE, padding=2, time_limit=LIMITS[method]))
    assert used == method
    assert mesh.vertices is surface.vertices and mesh.faces is surface.faces
    assert mesh.uvs.dtype == torch.float32 and 0.0 <= float(mesh.uvs.min()) <= float(mesh.uvs.max()) <= 1.0
    covering = covering_faces(mesh, SIZE)
    assert int(covering.sum(dim=1).max()) == 1
    assert float(covering.any(dim=1).float().mean()) > 0.25
    # A mirrored chart would turn around.
    assert float(uv_areas(mesh).min()) >= 0.0 and float((uv_areas(mesh) > 0).float().mean()) > 0.99
    # One UV belongs to one vertex: welded corners stay welded.
    owner = torch.full((len(mesh.uvs),), -1)
    owner[mesh.face_uvs[uv_areas(mesh) > 0].flatten()] = mesh.faces[uv_areas(mesh) > 0].flatten()
    assert torch.equal(owner[mesh.face_uvs[uv_areas(mesh) > 0]], mesh.faces[uv_areas(mesh) > 0])


def test_projection_keeps_charts_apart_by_the_padding(surface):
    padding = 4
    chart, _ = projection_charts(surface.vertices, surface.faces)
    mesh, _ = unwrap(surface, UnwrapConfig(SIZE, padding=padding, time_limit=0.0))
    corners = (mesh.uvs * SIZE)[mesh.face_uvs]
    boxes = []
    for number in range(mesh.charts):
        points = corners[chart == number].reshape(-1, 2)
        boxes.append((points.amin(dim=0), points.amax(dim=0)))
    for i, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:i]:
            gap = torch.maximum(low - other_high, other_low - high).max()
            assert float(gap) > padding - 1e-3


def test_projection_has_one_scale():
    mesh = bumpy_ball()
    chart, plane = projection_charts(mesh.vertices, mesh.faces)
    atlas, _ = unwrap(mesh, UnwrapConfig(SIZE, time_limit=0.0))
    a, b, c = plane.double().unbind(dim=1)
    flat = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    ratio = uv_areas(atlas) / flat
    assert float(ratio.max() / ratio.min()) < 1.01
    # By the nearest axis, no face shrinks to less than 1 / sqrt(3).
    a, b, c = mesh.vertices[mesh.faces].double().unbind(dim=1)
    assert bool((flat >= torch.linalg.cross(b - a, c - a).norm(dim=1) / 2 / math.sqrt(3) * (1 - 1e-6)).all())


def test_a_ramp_over_itself_becomes_several_charts():
    ramp = spiral_ramp()
    chart, _ = projection_charts(ramp.vertices, ramp.faces)
    assert 3 <= int(chart.max()) + 1 <= 12


@pytest.mark.parametrize("method", LIMITS)
def test_faces_without_area_break_nothing(method):
    ball = bumpy_ball()
    flat = torch.tensor([[5, 5, 9], [3, 3, 3]])
    mesh = TriangleMesh(ball.vertices, torch.cat([ball.faces, flat]))
    atlas, used = unwrap(mesh, UnwrapConfig(SIZE, time_limit=LIMITS[method]))
    assert used == method
    assert float(uv_areas(atlas)[-2:].abs().max()) == 0.0
    assert int(covering_faces(atlas, SIZE).sum(dim=1).max()) == 1


def test_more_charts_than_the_atlas_has_room_for_gaps_are_still_packed():
    corner = torch.rand(1500, 1, 3, generator=torch.Generator().manual_seed(0)) * 10.0
    triangle = torch.tensor([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    soup = TriangleMesh((corner + triangle).reshape(-1, 3), torch.arange(4500).reshape(-1, 3))
    atlas, _ = unwrap(soup, UnwrapConfig(64, time_limit=0.0))
    assert 0.0 <= float(atlas.uvs.min()) <= float(atlas.uvs.max()) <= 1.0
    assert float(uv_areas(atlas).min()) > 0.0
    assert int(covering_faces(atlas, 64).sum(dim=1).max()) == 1


@pytest.fixture
def processes(monkeypatch) -> list[subprocess.Popen]:
    """The processes that unwrapping starts."""
    started = []

    class Recorded(subprocess.Popen):
        def __init__(self, *args, **kwargs) -> None:
            super().__init__(*args, **kwargs)
            started.append(self)

    monkeypatch.setattr(unwrap_module.subprocess, "Popen", Recorded)
    return started


@pytest.fixture
def endless_worker(monkeypatch, tmp_path):
    """In the place of xatlas: a process that never ends by itself."""
    worker = tmp_path / "endless.py"
    worker.write_text("import time\nwhile True:\n    time.sleep(1)\n")
    monkeypatch.setattr(unwrap_module, "WORKER", worker)


def test_cancelling_leaves_no_process(processes, endless_worker):
    fractions = []

    def cancel(fraction: float, message: str) -> None:
        fractions.append(fraction)
        if len(fractions) == 3:
            raise Cancelled("stopped")

    with pytest.raises(Cancelled):
        unwrap(bumpy_ball(), UnwrapConfig(SIZE), cancel)
    assert fractions == sorted(fractions) and 0.0 <= fractions[0] <= fractions[-1] <= 1.0
    assert len(processes) == 1 and processes[0].returncode is not None


def test_the_time_limit_ends_in_a_projection(processes, endless_worker):
    mesh, method = unwrap(bumpy_ball(), UnwrapConfig(SIZE, time_limit=0.3))
    assert method == "projection" and mesh.charts >= 6
    assert len(processes) == 1 and processes[0].returncode is not None


@pytest.mark.parametrize("script", ["raise SystemExit(3)", "print('nothing written')", "import no_such_module"])
def test_a_failing_worker_ends_in_a_projection(monkeypatch, tmp_path, script):
    worker = tmp_path / "failing.py"
    worker.write_text(script)
    monkeypatch.setattr(unwrap_module, "WORKER", worker)
    assert unwrap(bumpy_ball(), UnwrapConfig(SIZE))[1] == "projection"


def test_a_python_that_cannot_be_started_ends_in_a_projection(monkeypatch, tmp_path):
    monkeypatch.setattr(unwrap_module.sys, "executable", str(tmp_path / "no-python"))
    assert unwrap(bumpy_ball(), UnwrapConfig(SIZE))[1] == "projection"


@pytest.mark.parametrize(
    "mesh",
    [
        TriangleMesh(torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.int64)),
        TriangleMesh(torch.full((3, 3), torch.nan), torch.tensor([[0, 1, 2]])),
    ],
)
def test_what_cannot_be_unwrapped_is_an_error(mesh):
    with pytest.raises(UnwrapError):
        unwrap(mesh, UnwrapConfig(SIZE))
