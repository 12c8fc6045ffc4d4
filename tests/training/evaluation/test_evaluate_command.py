"""`python -m training evaluate` on objects whose answer is known."""

import csv
import functools
import json
import math

import numpy as np
import pytest
import torch
import trimesh

from arm_blender import pipeline
from arm_blender.config import QUALITIES
from arm_blender.errors import EmptyMeshError
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.color import linear_from_srgb, srgb_from_linear
from arm_blender.graphics.raster.rasterize import interpolate, rasterize
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, RelightableAsset, TriangleMesh, ViewSet
from arm_blender.uv.unwrap import UnwrapConfig, unwrap
from arm_blender.views import ViewOptions, load_views
from arm_blender.views.image_io import write_png
from arm_blender.views.rigs import zero123plus_rig
from arm_blender.views.transforms_json import write_transforms
from training.__main__ import main
from training.evaluation.scores.geometry import FAILED, GeometryScores
from training.evaluation.scores.rerender import rerender_psnr
from training.evaluation.tables.shape_table import ObjectResult, mean_scores, verdict
from training.studies import sweep
from training.studies.left_out import variants

GOOD, FAIR = GeometryScores(0.9, 0.5, 0.04, 20.0), GeometryScores(0.8, 0.4, 0.06, 25.0)


def ball(radius: float = 0.8) -> TriangleMesh:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return TriangleMesh(torch.tensor(np.asarray(mesh.vertices), dtype=torch.float32), torch.tensor(mesh.faces.copy()))


def result(ours: GeometryScores, hull: GeometryScores) -> ObjectResult:
    return ObjectResult("cup", ours, hull, seconds=1.0, faces=100)


@pytest.fixture
def ball_views(tmp_path):
    """A folder of views of one ball, as the renderer writes it."""
    folder = tmp_path / "views" / "ball"
    folder.mkdir(parents=True)
    cameras = [orbit_camera(60.0 * k, (20.0, -10.0)[k % 2], 6.0, 30.0, 64, 64) for k in range(6)]
    names = [f"{k:03d}.png" for k in range(6)]
    for name, camera in zip(names, cameras, strict=True):
        mask = rasterize(ball().vertices, ball().faces, camera).mask.float()
        write_png(folder / name, mask.expand(4, -1, -1), srgb=True)
    write_transforms(folder / "transforms.json", names, cameras)
    np.savez(folder / "mesh.npz", vertices=ball().vertices.numpy(), faces=ball().faces.numpy())
    return tmp_path / "views"


def test_a_network_that_knows_the_truth_beats_the_hull(ball_views, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("ARM_DATA", raising=False)
    monkeypatch.setattr(pipeline, "shape", lambda views, settings: ball())
    assert main(["evaluate", "--views", str(ball_views), "--output", str(tmp_path / "out"), "--grid", "32"]) == 0
    assert "NOT" not in capsys.readouterr().out
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["command"].startswith("python -m training evaluate --views ")
    (item,) = results["objects"]
    assert item["ours"]["f_coarse"] == 1.0
    # What is left of the distance is the spacing of 100,000 samples of a sphere.
    assert item["ours"]["chamfer"] == pytest.approx(math.sqrt(4.0 * math.pi * 0.8**2 / 100_000), rel=0.05)
    assert item["hull"]["chamfer"] > item["ours"]["chamfer"]
    assert (tmp_path / "out" / "ball.png").stat().st_size > 0


def test_a_network_that_finds_nothing_fails_and_stays_in_the_mean(ball_views, tmp_path, monkeypatch, capsys):
    def nothing(views, settings):
        raise EmptyMeshError("no surface")

    monkeypatch.delenv("ARM_DATA", raising=False)
    monkeypatch.setattr(pipeline, "shape", nothing)
    assert main(["evaluate", "--views", str(ball_views), "--output", str(tmp_path), "--grid", "32", "--no-sheets"]) == 0
    assert capsys.readouterr().out.count("does NOT beat") == 4
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["mean"]["ours"] == {"f_coarse": 0.0, "f_fine": 0.0, "chamfer": None, "angle": 90.0}


def test_the_means_are_over_all_objects():
    results = [result(GOOD, FAIR), result(FAIR, FAIR)]
    assert mean_scores(results, "ours").f_coarse == pytest.approx(0.85)
    assert mean_scores(results, "hull") == FAIR
    assert math.isinf(mean_scores([result(GOOD, FAIR), result(FAILED, FAIR)], "ours").chamfer)


def test_the_verdict_knows_that_a_small_distance_is_good():
    assert verdict([result(GOOD, FAIR)]).count("the network beats") == 4
    assert verdict([result(FAIR, GOOD)]).count("does NOT beat") == 4
    assert verdict([result(GOOD, GOOD)]).count("does NOT beat") == 4  # Equal is not better.


@pytest.fixture
def quick_sweep(monkeypatch, ball_views):
    """A sweep whose pipeline returns the ball at once, and that compares fewer points."""
    monkeypatch.delenv("ARM_DATA", raising=False)
    monkeypatch.setattr(sweep, "compare", functools.partial(sweep.compare, samples=10_000))

    def generate(views, settings):
        if settings.grid == 32:
            raise EmptyMeshError("no surface")
        mesh, _ = unwrap(ball(), UnwrapConfig(256, time_limit=0.0))
        grey = torch.full((3, 256, 256), 0.2)
        report = Report("small", "cpu", 0)
        report.seconds = {"shape": settings.resolved.grid / 64.0, "unwrap": 1.0, "appearance": len(views.cameras)}
        return RelightableAsset("ball", mesh, MaterialMaps(grey, grey, grey[:1], grey[:1])), report

    monkeypatch.setattr(pipeline, "generate", generate)


SWEEP = ["--grids", "48", "--faces", "500", "1000", "--textures", "256", "--rounds", "0", "--counts", "1", "2"]


def test_a_sweep_turns_every_knob_and_has_a_row_for_every_quality(ball_views, tmp_path, quick_sweep):
    output, picture = tmp_path / "sweep.md", tmp_path / "images" / "sweep.png"
    words = ["--views", str(ball_views), *SWEEP, "--output", str(output), "--plot", str(picture)]
    assert main(["sweep", *words]) == 0
    rows = list(csv.DictReader(output.with_suffix(".csv").open()))
    turned = ["grid", *["faces"] * 2, "texture size", "refinement", *["views"] * 2]
    assert [row["label"] for row in rows] == [*QUALITIES, *turned, "balanced again"]
    assert [int(row["views"]) for row in rows if row["label"] == "views"] == [1, 2]
    assert all(float(row["f_coarse"]) == 1.0 and float(row["faces"]) == len(ball().faces) for row in rows)
    text = output.read_text()
    assert all(f"| {name} |" in text for name in QUALITIES) and "(images/sweep.png)" in text
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_sweep_goes_on_where_a_grid_finds_nothing(ball_views, tmp_path, quick_sweep):
    output = tmp_path / "sweep.md"
    words = ["--views", str(ball_views), *SWEEP[2:], "--grids", "32", "--output", str(output)]
    assert main(["sweep", *words, "--plot", str(tmp_path / "sweep.png")]) == 0
    scores = {row["grid"]: float(row["f_coarse"]) for row in csv.DictReader(output.with_suffix(".csv").open())}
    assert scores.pop("32") == 0.0 and set(scores.values()) == {1.0}


def sweep_row(seconds: float, chamfer: float) -> sweep.SweepRow:
    return sweep.SweepRow("grid", 64, 500, 256, 2, 6, 500.0, 1.0, 1.0, chamfer, 15.0, 30.0, seconds, 0.0, 0.0)


def test_a_point_is_beaten_by_more_than_noise_in_one_thing_and_by_none_in_the_others():
    def row(seconds: float, chamfer: float, psnr: float) -> sweep.SweepRow:
        return sweep.SweepRow("grid", 64, 1, 1, 2, 6, 1.0, 0.0, 0.0, chamfer, 15.0, psnr, seconds, 0.0, 0.0)

    fast, good = row(1.0, 0.050, 25.0), row(10.0, 0.040, 26.0)
    alike = [row(1.1, 0.0504, 24.95), row(9.0, 0.0397, 25.95)]
    beaten = [row(1.2, 0.050, 25.0), row(10.0, 0.041, 26.0), row(10.0, 0.040, 25.8), row(20.0, 0.0399, 26.05)]
    assert sweep.unbeaten([good, *alike, *beaten, fast]) == [fast, alike[0], alike[1], good]


def test_the_pareto_front_is_what_nothing_beats_in_both():
    best = [sweep_row(1.0, 0.3), sweep_row(2.0, 0.2), sweep_row(4.0, 0.1)]
    beaten = [sweep_row(2.0, 0.25), sweep_row(3.0, 0.2), sweep_row(9.0, 0.1), sweep_row(5.0, 0.4)]
    assert sweep.pareto([*beaten, *best], "chamfer") == best


@pytest.mark.parametrize("count", range(1, 7))
def test_fewer_views_are_spread_around_the_object(count):
    chosen = sweep.spread(count)
    assert len(set(chosen)) == count and set(chosen) <= set(range(6))
    gaps = [(b - a) % 6 or 6 for a, b in zip(chosen, [*chosen[1:], chosen[0]], strict=True)]
    assert max(gaps) - min(gaps) <= 1


def test_rendering_the_true_texture_back_gives_the_views():
    mesh, _ = unwrap(ball(), UnwrapConfig(256, time_limit=0.0))
    cameras = zero123plus_rig(distance=6.0, size=64)
    images = torch.stack([torch.cat([torch.full((3, 64, 64), 0.2), torch.ones(1, 64, 64)])] * 6)
    views = ViewSet(images, cameras, torch.ones(6), "ball")
    grey = torch.full((3, 256, 256), 0.2)
    asset = RelightableAsset("ball", mesh, MaterialMaps(grey, grey, grey[:1], grey[:1]))
    assert rerender_psnr(asset, views) > 100.0
    # A tenth of the range away, in sRGB, is 20 dB.
    off = linear_from_srgb(srgb_from_linear(grey) + 0.1)
    wrong = RelightableAsset("ball", mesh, MaterialMaps(off, off, grey[:1], grey[:1]))
    assert rerender_psnr(wrong, views) == pytest.approx(20.0, abs=0.01)
    empty = ViewSet(images * torch.tensor([1.0, 1.0, 1.0, 0.0]).view(4, 1, 1), cameras, torch.ones(6), "ball")
    assert math.isnan(rerender_psnr(asset, empty))


def test_a_texture_is_rendered_the_right_way_up():
    """Every pixel shows its own UV."""
    mesh, _ = unwrap(ball(), UnwrapConfig(256, time_limit=0.0))
    camera = zero123plus_rig(distance=6.0, size=64)[0]
    center = (torch.arange(256) + 0.5) / 256
    texture = torch.stack(
        [center[None].expand(256, 256), 1.0 - center[:, None].expand(256, 256), torch.zeros(256, 256)]
    )
    fragments = rasterize(mesh.vertices, mesh.faces, camera)
    uv = interpolate(mesh.uvs, mesh.face_uvs, fragments)
    image = torch.cat([uv, torch.zeros(1, 64, 64), fragments.mask[None].float()])
    asset = RelightableAsset("ball", mesh, MaterialMaps(texture, texture, texture[:1], texture[:1]))
    assert rerender_psnr(asset, ViewSet(image[None], (camera,), torch.ones(1), "ball")) > 50.0


def test_the_variants_of_a_scene_need_less_than_it_does(ball_views):
    views = load_views(ball_views / "ball", ViewOptions())
    before = views.images.clone()
    scenes = dict(variants(views))
    assert [len(scenes[title].cameras) for title in ("six views", "the first three", "the first alone")] == [6, 3, 1]
    grey = scenes["six views of one flat grey"].images
    assert grey[:, :3].unique().numel() == 1 and torch.equal(grey[:, 3], before[:, 3])
    assert torch.equal(views.images, before)  # No variant changes what it was made from.
