"""Atlases, packed both ways: no texel twice, nothing outside, the mesh unchanged, the process under control."""

import math
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor

from arm_blender.errors import Cancelled, UnwrapError
from arm_blender.graphics.connectivity import components, half_edges, manifold_pairs
from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, extract
from arm_blender.structures import TriangleMesh, UvMesh
from arm_blender.uv import unwrap as unwrap_module
from arm_blender.uv.charts import SMALL, projection_charts, smooth_charts
from arm_blender.uv.decimate import decimate
from arm_blender.uv.flatten import _projected, flat_charts
from arm_blender.uv.overlaps import layers
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

ROOT = Path(__file__).parents[2]

SIZE = 96
LIMITS = {"xatlas": 60.0, "shelves": 0.0}


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


def chart_of(mesh: UvMesh) -> Tensor:
    """(F,) chart of each face: faces that share a UV."""
    return torch.unique(components(half_edges(mesh.face_uvs), len(mesh.uvs))[mesh.face_uvs[:, 0]], return_inverse=True)[
        1
    ]


def seam_length(mesh: TriangleMesh, chart: Tensor) -> float:
    pairs = manifold_pairs(mesh.faces)
    start, end = half_edges(mesh.faces)[pairs[:, 0]].unbind(dim=1)
    length = (mesh.vertices[start] - mesh.vertices[end]).norm(dim=1)
    return float(length[chart[pairs[:, 0] // 3] != chart[pairs[:, 1] // 3]].sum())


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


@pytest.mark.parametrize("method", LIMITS)
def test_charts_are_apart_by_the_padding(surface, method):
    padding = 4
    mesh, _ = unwrap(surface, UnwrapConfig(SIZE, padding=padding, time_limit=LIMITS[method]))
    # Texels whose centres lie in different charts are further apart than the padding, less a texel for each centre.
    covering = covering_faces(mesh, SIZE)
    chart = torch.where(covering.any(dim=1), chart_of(mesh)[covering.int().argmax(dim=1)], -1)
    rows, columns = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    place = torch.stack([rows, columns], dim=-1).reshape(-1, 2)[chart >= 0].float()
    number = chart[chart >= 0]
    gap = torch.cdist(place, place)[number[:, None] != number[None]]
    assert mesh.charts == int(chart_of(mesh).max()) + 1 > 1
    assert float(gap.min()) > padding - 2


@pytest.mark.parametrize("method", LIMITS)
def test_an_atlas_hardly_stretches(surface, method):
    atlas, _ = unwrap(surface, UnwrapConfig(SIZE, time_limit=LIMITS[method]))
    a, b, c = surface.vertices[surface.faces].double().unbind(dim=1)
    ratio = uv_areas(atlas) / (torch.linalg.cross(b - a, c - a).norm(dim=1) / 2)
    share = ratio / ratio.median()
    assert float(share.quantile(0.01)) > 0.7 and float(share.quantile(0.99)) < 1.25


def test_what_develops_is_laid_flat_without_stretch():
    """A quarter of a cylinder: every edge keeps its length."""
    angle, height = torch.meshgrid(torch.linspace(-0.75, 0.75, 15), torch.linspace(-1.0, 1.0, 9), indexing="ij")
    vertices = torch.stack([angle.sin(), -angle.cos(), height], dim=-1).reshape(-1, 3)
    corner = (torch.arange(14)[:, None] * 9 + torch.arange(8)).flatten()
    faces = torch.cat(
        [torch.stack([corner, corner + 9, corner + 10], 1), torch.stack([corner, corner + 10, corner + 1], 1)]
    )
    chart, plane = flat_charts(vertices, faces, math.inf)
    assert int(chart.max()) == 0
    solid, flat = vertices[faces], plane
    ratio = (flat - flat.roll(-1, 1)).norm(dim=-1) / (solid - solid.roll(-1, 1)).norm(dim=-1)
    assert float(ratio.min()) > 0.99 and float(ratio.max()) < 1.01
    projected, _ = _projected(vertices, faces, chart)
    assert (
        float((projected - projected.roll(-1, 1)).norm(dim=-1).min() / (solid - solid.roll(-1, 1)).norm(dim=-1).max())
        < 0.8
    )


def test_after_the_deadline_charts_are_still_valid():
    ball = bumpy_ball()
    chart, plane = flat_charts(ball.vertices, ball.faces, -math.inf)
    a, b, c = plane.unbind(dim=1)
    assert bool(((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] > 0).all())
    assert 6 <= int(chart.max()) + 1 < 40


def test_few_large_charts_fill_the_atlas():
    atlas, used = unwrap(bumpy_ball(), UnwrapConfig(512, padding=2))
    areas = uv_areas(atlas)
    assert used == "xatlas" and atlas.charts < 12
    assert float(areas.min()) >= 0.0, "a chart is mirrored"
    assert float(areas.sum()) > 0.45


def test_smoothing_shortens_seams():
    ball = bumpy_ball()
    smooth = smooth_charts(ball.vertices, ball.faces)
    plain, _ = projection_charts(ball.vertices, ball.faces)
    assert seam_length(ball, smooth) < 0.9 * seam_length(ball, plain)
    assert int(smooth.max()) < int(plain.max())


def test_small_charts_join_a_neighbour():
    ball = bumpy_ball()
    chart = smooth_charts(ball.vertices, ball.faces)
    a, b, c = ball.vertices[ball.faces].unbind(dim=1)
    area = torch.linalg.cross(b - a, c - a).norm(dim=1)
    share = torch.zeros(int(chart.max()) + 1).index_add_(0, chart, area) / area.sum()
    assert float(share.min()) > SMALL


def test_a_ramp_over_itself_becomes_several_charts():
    ramp = spiral_ramp()
    chart, plane = flat_charts(ramp.vertices, ramp.faces, math.inf)
    assert 3 <= int(chart.max()) + 1 <= 12
    assert int(layers(plane, plane[:, 0, 0], chart).max()) == 0


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
        if len(processes) == 1:
            raise Cancelled("stopped")

    with pytest.raises(Cancelled):
        unwrap(bumpy_ball(), UnwrapConfig(SIZE), cancel)
    assert fractions == sorted(fractions) and 0.0 <= fractions[0] <= fractions[-1] <= 1.0
    assert len(processes) == 1 and processes[0].returncode is not None


def test_the_time_limit_ends_on_shelves(processes, endless_worker):
    mesh, method = unwrap(bumpy_ball(), UnwrapConfig(SIZE, time_limit=0.3))
    assert method == "shelves" and mesh.charts > 1
    assert len(processes) == 1 and processes[0].returncode is not None


def test_a_limit_that_charting_used_up_starts_no_process(processes, monkeypatch):
    clock, charting = [0.0], unwrap_module.flat_charts

    def slow(*args):
        clock[0] += 100.0
        return charting(*args)

    monkeypatch.setattr(unwrap_module.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(unwrap_module, "flat_charts", slow)
    mesh, method = unwrap(bumpy_ball(), UnwrapConfig(SIZE, time_limit=60.0))
    assert method == "shelves" and mesh.charts > 1 and not processes


@pytest.mark.parametrize("script", ["raise SystemExit(3)", "print('nothing written')", "import no_such_module"])
def test_a_failing_worker_ends_on_shelves(monkeypatch, tmp_path, script):
    worker = tmp_path / "failing.py"
    worker.write_text(script)
    monkeypatch.setattr(unwrap_module, "WORKER", worker)
    assert unwrap(bumpy_ball(), UnwrapConfig(SIZE))[1] == "shelves"


def test_without_a_folder_for_temporary_files_charts_end_on_shelves(monkeypatch, tmp_path):
    monkeypatch.setattr(unwrap_module.tempfile, "tempdir", str(tmp_path / "gone"))
    assert unwrap(bumpy_ball(), UnwrapConfig(SIZE))[1] == "shelves"


FULL = """
import gc, resource, sys, torch
from arm_blender.structures import TriangleMesh
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
rows, columns = torch.meshgrid(torch.arange(40), torch.arange(40), indexing="ij")
corner = (rows * 41 + columns).flatten()
halves = [torch.stack([corner, corner + a, corner + b], 1) for a, b in ((1, 42), (42, 41))]
faces = torch.cat(halves)
place = torch.stack(torch.meshgrid(torch.linspace(0, 1, 41), torch.linspace(0, 1, 41), indexing="ij"), -1).view(-1, 2)
mesh = TriangleMesh(torch.cat([place, (9.0 * place[:, :1]).sin()], 1), faces)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
print(unwrap(mesh, UnwrapConfig(256))[1])
gc.collect()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="it knows no limit of a file's size")
def test_a_full_folder_for_temporary_files_ends_on_shelves_without_a_traceback():
    done = subprocess.run([sys.executable, "-c", FULL], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.split() == ["shelves"], done.stderr
    assert "Traceback" not in done.stderr and "ignored" not in done.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere no limit is known")
def test_a_worker_that_takes_all_memory_ends_on_shelves(monkeypatch, tmp_path):
    worker = tmp_path / "hungry.py"
    worker.write_text("import time; time.sleep(1.0)\nheld = bytearray(2**30)\nopen('never', 'w')\nwhile True: pass")
    monkeypatch.setattr(unwrap_module, "WORKER", worker)
    monkeypatch.setattr(unwrap_module, "MEMORY", 2**29)
    monkeypatch.chdir(tmp_path)
    assert unwrap(bumpy_ball(), UnwrapConfig(SIZE))[1] == "shelves" and not (tmp_path / "never").exists()


def test_a_python_that_cannot_be_started_ends_on_shelves(monkeypatch, tmp_path):
    monkeypatch.setattr(unwrap_module.sys, "executable", str(tmp_path / "no-python"))
    assert unwrap(bumpy_ball(), UnwrapConfig(SIZE))[1] == "shelves"


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
