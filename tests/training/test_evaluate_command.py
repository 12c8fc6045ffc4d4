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
from arm_blender.graphics.rasterize import rasterize
from arm_blender.structures import TriangleMesh
from arm_blender.views import ViewOptions, load_views
from arm_blender.views.image_io import write_png
from arm_blender.views.transforms_json import write_transforms
from training.__main__ import main
from training.evaluation import sweep
from training.evaluation.evaluate import FAILED, ObjectResult, mean_scores, verdict
from training.evaluation.geometry import GeometryScores
from training.evaluation.left_out import variants

GOOD, FAIR = GeometryScores(0.9, 0.5, 0.04), GeometryScores(0.8, 0.4, 0.06)


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
    assert capsys.readouterr().out.count("does NOT beat") == 3
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["mean"]["ours"] == {"f_coarse": 0.0, "f_fine": 0.0, "chamfer": None}


def test_the_means_are_over_all_objects():
    results = [result(GOOD, FAIR), result(FAIR, FAIR)]
    assert mean_scores(results, "ours").f_coarse == pytest.approx(0.85)
    assert mean_scores(results, "hull") == FAIR
    assert math.isinf(mean_scores([result(GOOD, FAIR), result(FAILED, FAIR)], "ours").chamfer)


def test_the_verdict_knows_that_a_small_distance_is_good():
    assert verdict([result(GOOD, FAIR)]).count("the network beats") == 3
    assert verdict([result(FAIR, GOOD)]).count("does NOT beat") == 3
    assert verdict([result(GOOD, GOOD)]).count("does NOT beat") == 3  # Equal is not better.


@pytest.fixture
def quick_sweep(monkeypatch):
    """A sweep that unwraps nothing and compares fewer points."""
    monkeypatch.delenv("ARM_DATA", raising=False)
    monkeypatch.setattr(sweep, "unwrap", lambda mesh, config: None)
    monkeypatch.setattr(sweep, "compare", functools.partial(sweep.compare, samples=10_000))


def test_a_sweep_has_a_row_for_every_combination_and_quality(ball_views, tmp_path, monkeypatch, quick_sweep):
    monkeypatch.setattr(pipeline, "shape", lambda views, settings: ball())
    output = tmp_path / "sweep.md"
    words = ["--views", str(ball_views), "--grids", "32", "48", "--faces", "500", "1000", "--output", str(output)]
    assert main(["sweep", *words]) == 0
    rows = list(csv.DictReader(output.with_suffix(".csv").open()))
    chosen = {(int(row["grid"]), int(row["face_budget"])) for row in rows}
    assert chosen >= {(32, 500), (32, 1000), (48, 500), (48, 1000)}
    assert len(rows) == len(chosen) == 4 + len(QUALITIES)
    assert all(float(row["f_coarse"]) == 1.0 and float(row["faces"]) == len(ball().faces) for row in rows)
    assert all(f"| {name} |" in output.read_text() for name in QUALITIES)


def test_a_sweep_goes_on_where_a_grid_finds_nothing(ball_views, tmp_path, monkeypatch, quick_sweep):
    def shape(views, settings):
        if settings.grid == 32:
            raise EmptyMeshError("no surface")
        return ball()

    monkeypatch.setattr(pipeline, "shape", shape)
    output = tmp_path / "sweep.md"
    words = ["--views", str(ball_views), "--grids", "32", "--faces", "500", "--output", str(output)]
    assert main(["sweep", *words]) == 0
    scores = {row["grid"]: float(row["f_coarse"]) for row in csv.DictReader(output.with_suffix(".csv").open())}
    assert scores.pop("32") == 0.0 and set(scores.values()) == {1.0}


def test_the_variants_of_a_scene_need_less_than_it_does(ball_views):
    views = load_views(ball_views / "ball", ViewOptions())
    before = views.images.clone()
    scenes = dict(variants(views))
    assert [len(scenes[title].cameras) for title in ("six views", "the first three", "the first alone")] == [6, 3, 1]
    grey = scenes["six views of one flat grey"].images
    assert grey[:, :3].unique().numel() == 1 and torch.equal(grey[:, 3], before[:, 3])
    assert torch.equal(views.images, before)  # No variant changes what it was made from.
