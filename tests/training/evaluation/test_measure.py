"""One object through the evaluation, with a pipeline whose answer is known; nothing is lit, so no Blender is needed."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from arm_blender import pipeline
from arm_blender.config import Settings
from arm_blender.errors import EmptyMeshError
from arm_blender.graphics.color import srgb_from_linear
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, RelightableAsset
from arm_blender.views import ViewOptions
from training.__main__ import main
from training.evaluation import evaluate
from training.evaluation.scores.alignment import AlignmentConfig
from training.evaluation.scores.geometry import FAILED
from training.evaluation.scores.image_scores import MISSED, PSNR_CAP
from training.evaluation.tables import contact_sheet, sheets
from training.evaluation.trials.asset_pictures import map_pictures
from training.evaluation.trials.measure import BLEND, HULL, ONE_VIEW, OURS, PICTURE, PROVIDER, SCALED, measure
from training.evaluation.trials.trial import Trial
from training.evaluation.truth.objects import EvaluationObject
from training.evaluation.truth.protocol import EvaluationEntry, Protocol
from training.evaluation.truth.truth import Truth

PROTOCOL = Protocol(resolution=64, views=4)  # Of `ball_data`.
SETTINGS = Settings(grid=32, faces=1000, texture_size=256)


@pytest.fixture
def asset(ball_asset) -> RelightableAsset:
    return ball_asset


@pytest.fixture
def scene(ball_data, asset):
    """Entry, views as files and truth of the ball; the truth is not rounded to bytes."""
    item = EvaluationObject("ball", ball_data / "truth" / PROTOCOL.folder / "ball")
    shown = (map_pictures(asset, cameras) for cameras in (PROTOCOL.tests(), (PROTOCOL.front(),)))
    return EvaluationEntry("ball", ball_data / "ball.glb", "pbr"), item, Truth(*shown, ball_data, ball_data)


def answer(monkeypatch, asset: RelightableAsset) -> None:
    monkeypatch.setattr(pipeline, "generate", lambda views, settings, mesh=None: (asset, Report("small", "cpu", 0)))


def trial(**changes) -> Trial:
    alignment = AlignmentConfig(scales=(0.7, 1.0, 1.4), points=300, refined=2, rounds=10)
    return Trial(SETTINGS, PROTOCOL, points=5_000, alignment=alignment, cycles=False, **changes)


def test_the_truth_scores_its_bounds(scene, asset, monkeypatch):
    answer(monkeypatch, asset)
    result, shown = measure(*scene, trial(one_view=False))
    ours = result.systems[OURS]
    assert ours.geometry.f_coarse == ours.aligned.f_coarse == ours.overlap == 1.0
    assert {scores.psnr_in for scores in ours.maps.values()} == {PSNR_CAP}
    assert ours.maps["albedo"].ssim == pytest.approx(1.0)
    assert "lit" not in ours.maps  # Nothing was rendered by Cycles.
    # The views are unlit colours: blending them finds the albedo, as far as pixels tell, and so does the hull.
    assert result.systems[BLEND].maps["albedo"].psnr_in > 25.0
    assert result.systems[HULL].maps["albedo"].psnr_in > 20.0
    assert result.systems[HULL].geometry.chamfer > ours.geometry.chamfer
    assert [len(result.moments[name]) for name in ("roughness", "metallic")] == [4, 4]
    assert sheets.object_sheet(shown).width == 6 * contact_sheet.TILE


def test_a_darker_albedo_is_wrong_but_for_its_scale(scene, asset, monkeypatch):
    maps = asset.maps
    darker = MaterialMaps(0.5 * maps.albedo, maps.baked, maps.roughness, maps.metallic)
    answer(monkeypatch, RelightableAsset("ball", asset.mesh, darker))
    result, _ = measure(*scene, trial(one_view=False))
    found = result.systems[OURS].maps
    assert found[SCALED].psnr_in > 40.0
    error = (srgb_from_linear(maps.albedo) - srgb_from_linear(0.5 * maps.albedo)).square().mean()
    assert found["albedo"].psnr_in == pytest.approx(float(-10.0 * torch.log10(error)), abs=1.5)


def test_what_finds_no_surface_scores_nothing_and_the_hull_still_counts(scene, monkeypatch):
    def nothing(views, settings, mesh=None):
        raise EmptyMeshError("no surface")

    monkeypatch.setattr(pipeline, "generate", nothing)
    result, shown = measure(*scene, trial(others={"ablation": SETTINGS}))
    for name in (OURS, "ablation", ONE_VIEW):
        assert result.systems[name].geometry == FAILED
        assert set(result.systems[name].maps.values()) == {MISSED}
    assert result.systems[PICTURE].aligned == FAILED and result.systems[PICTURE].geometry is None
    assert result.systems[HULL].geometry.f_coarse > 0.95 and result.moments == {}
    assert sheets.object_sheet(shown).size[0] > 0  # Gaps where nothing came out.


def test_single_views_and_a_provider_are_tried_where_they_are_asked_for(scene, asset, monkeypatch):
    turned = asset.mesh.moved(lambda v: 0.5 * torch.stack([-v[:, 1], v[:, 0], v[:, 2]], dim=1) + 3.0)
    answer(monkeypatch, RelightableAsset("ball", turned, asset.maps))
    result, _ = measure(*scene, trial(provider=lambda name: ViewOptions()))
    for name in (PICTURE, PROVIDER):  # Their frame is unknown: aligned, a moved copy is the truth.
        assert result.systems[name].geometry is None
        assert result.systems[name].aligned.f_coarse == 1.0
        assert result.systems[name].overlap > 0.95
    assert result.systems[ONE_VIEW].geometry.f_coarse == 0.0  # Its frame is known: elsewhere is wrong.


def test_what_brings_no_shape_is_given_ours(scene, asset, monkeypatch, tmp_path):
    """And one that does is asked for it."""
    asked, folders = [], {name: tmp_path / name for name in ("albedo", "shape")}
    for folder, network in zip(folders.values(), ("instant_albedo", "georm"), strict=True):
        folder.mkdir()
        (folder / SETTINGS.weights(network).name).touch()

    def generate(views, settings, mesh=None):
        asked.append((settings.weights_folder, mesh))
        return asset, Report("small", "cpu", 0)

    monkeypatch.setattr(pipeline, "generate", generate)
    others = {name: replace(SETTINGS, weights_folder=folder) for name, folder in folders.items()}
    others["other grid"] = replace(SETTINGS, grid=48)
    result, _ = measure(*scene, trial(one_view=False, others=others))
    given = [mesh is asset.mesh for _, mesh in asked]
    assert [folder for folder, _ in asked] == [None, *folders.values(), None]
    assert given == [False, True, False, False] and all(mesh is None for _, mesh in asked[2:])
    ours = result.systems[OURS]
    assert all((s.geometry, s.aligned) == (ours.geometry, ours.aligned) for s in map(result.systems.get, others))
    assert result.systems[BLEND].geometry is None


def test_lpips_is_a_column_where_its_weights_are_named(ball_data, asset, monkeypatch, capsys):
    """Weights of the right shapes at random widths: the distances are the network's, and 0 of what is the truth."""
    answer(monkeypatch, asset)
    monkeypatch.setattr(evaluate, "measured_cost", lambda views, trial: None)
    weights = load_file(Path(__file__).parents[2] / "data" / "parity" / "lpips_narrow_alex.safetensors")
    file = ball_data / "lpips.alex.safetensors"
    save_file({k.removeprefix("weights/"): t for k, t in weights.items() if k.startswith("weights/")}, file)
    words = ["--data", str(ball_data), "--cache", str(ball_data / "truth"), "--output", str(ball_data / "out")]
    words += ["--resolution", "64", "--test-views", "4", "--no-cycles", "--no-single", "--no-sheets", "--grid", "32"]
    assert main(["evaluate", *words]) == 0
    assert "LPIPS" not in capsys.readouterr().out
    assert main(["evaluate", *words, "--lpips", str(file)]) == 0
    table = capsys.readouterr().out.partition("## Means over the set `pbr`")[2].strip().splitlines()
    columns = [cell.strip() for cell in table[0].split("|")]
    rows = {line.split("|")[1].strip(): [cell.strip() for cell in line.split("|")] for line in table[2:5]}
    place = columns.index("albedo LPIPS")
    assert float(rows[OURS][place]) == 0.0 < float(rows[HULL][place])
    (item,) = json.loads((ball_data / "out" / "results.json").read_text())["objects"]
    shown = item["systems"][HULL]["maps"]
    assert shown["albedo"]["lpips"] == pytest.approx(float(rows[HULL][place]), abs=6e-4)
    assert shown["roughness"]["lpips"] > 0.0  # One channel is shown to the network as grey.
