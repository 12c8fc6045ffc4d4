"""The tables of an evaluation: bars, means, verdicts, and the objects and weights that words choose."""

import json
import math
from dataclasses import replace

import pytest

from arm_blender.config import Settings
from arm_blender.errors import ArmError
from training.__main__ import main
from training.evaluation.scores.geometry import FAILED, GeometryScores
from training.evaluation.scores.image_scores import MISSED, ImageScores, ViewMoments
from training.evaluation.scores.light import LightScores
from training.evaluation.tables.bars import BARS, Cost, bars_table, mean
from training.evaluation.tables.output import write_tables
from training.evaluation.tables.report_text import as_json, means_table, objects_table, verdicts
from training.evaluation.tables.resume import kept_results
from training.evaluation.trials.measure import BLEND, HULL, ONE_VIEW, OURS, PICTURE, ObjectResult, SystemResult
from training.evaluation.trials.other_system import mesh_of
from training.evaluation.trials.trial import Trial
from training.evaluation.truth.entries import evaluation_entries, spread
from training.evaluation.truth.protocol import EvaluationEntry, Protocol

MAPS = ("albedo", "roughness", "metallic", "lit", "relit", "albedo scaled")


def system(level: float) -> SystemResult:
    """1 is perfect, 0 is nothing."""
    shape = GeometryScores(level, level, 0.2 * (1.0 - level), 60.0 * (1.0 - level))
    return SystemResult(shape, shape, level, dict.fromkeys(MAPS, ImageScores(40.0 * level, 50.0 * level, level)))


def result(name: str, ours: float, others: float, kind: str = "pbr") -> ObjectResult:
    systems = {
        OURS: system(ours),
        BLEND: system(others),
        HULL: system(others),
        ONE_VIEW: system(ours),
        PICTURE: system(ours),
    }
    flat = [ViewMoments(0.5, 0.25 + 0.01)]  # No constant scores more than 20 dB.
    return ObjectResult(
        name, kind, systems, system(1.0).geometry, {"roughness": flat, "metallic": flat}, {"shape": 2.0}
    )


def reached(table: str) -> list[str]:
    return [line.split("|")[-2].strip() for line in table.splitlines()[2:]]


def test_what_is_perfect_reaches_every_aim():
    results = [result("a", 1.0, 0.5), result("b", 1.0, 0.5, "gso")]
    assert set(reached(bars_table(results, Cost(5.0, 2.0, 10.0)))) == {"aim"}


def test_the_light_stands_with_its_object_and_in_a_sentence():
    scores = {"a": LightScores(20.0, 18.0), "b": LightScores(24.0, 18.0)}
    lit = [replace(result(name, 1.0, 0.5), light=light) for name, light in scores.items()]
    assert "22.0 dB of its irradiance, and the views drawn under it 18.0 dB, in the mean of 2 objects" in verdicts(lit)
    assert "light, dB" in objects_table(lit) and "| 24.0" in objects_table(lit)
    assert "light, dB" not in objects_table([result("a", 1.0, 0.5)])
    assert "light" not in verdicts([result("a", 1.0, 0.5)])


def test_what_finds_nothing_reaches_no_bar_and_stays_in_the_table():
    nothing = SystemResult(FAILED, FAILED, 0.0, dict.fromkeys(MAPS, MISSED))
    lost = [
        ObjectResult(kind, kind, dict.fromkeys((OURS, BLEND, HULL, ONE_VIEW, PICTURE), nothing), FAILED, {}, {})
        for kind in ("gso", "pbr")
    ]
    assert set(reached(bars_table(lost, Cost(99.0, 99.0, 99.0)))) == {"**no**"}
    assert json.dumps(as_json(lost), allow_nan=False)
    assert "-" in means_table(lost, "pbr") and "gso" in objects_table(lost)


def test_a_bar_lies_between_must_and_aim():
    for bar in BARS:
        assert (bar.aim <= bar.must) if bar.lower else (bar.aim >= bar.must)
    between = reached(bars_table([result("a", 0.985, 0.5, "gso")], None))[0]  # F-score@0.1: 0.98 and 0.99.
    assert between == "must"


def test_a_set_that_was_not_run_is_not_measured():
    table = bars_table([result("a", 1.0, 0.5, "gso")], Cost(math.nan, 2.0, 10.0))
    rows = {line.split("|")[1].strip(): line for line in table.splitlines()}
    assert "not measured" in rows["PBR set albedo PSNR in"]
    assert "not measured" in rows["seconds from six views to the asset, cold"]


def test_means_are_over_the_objects_of_the_sets_asked_for():
    results = [result("a", 0.8, 0.5), result("b", 0.4, 0.5), result("c", 0.1, 0.5, "gso")]
    overlap = lambda r: r.overlap  # noqa: E731
    assert mean(results, ("pbr",), OURS, overlap) == pytest.approx(0.6)
    assert mean(results, (), OURS, overlap) == pytest.approx(1.3 / 3.0)
    assert mean(results, ("pbr",), "provider", overlap) is None


def test_a_network_that_does_not_beat_its_baseline_is_named():
    good, bad = verdicts([result("a", 0.9, 0.5)]), verdicts([result("a", 0.1, 0.5)])
    assert "NOT" not in good and good.count("the finish beats") == 4
    assert bad.count("does NOT beat") == len(bad.splitlines()) == len(good.splitlines())
    assert verdicts([result("a", 0.5, 0.5)]).count("InstantAlbedo does NOT beat") == 1  # Equal is not better.


def test_weights_of_another_folder_stand_in_for_those_of_their_name(tmp_path):
    shipped = Settings()
    other = Settings(weights_folder=tmp_path)
    assert other.weights("georm") == shipped.weights("georm")
    trained = tmp_path / shipped.weights("georm").name
    trained.touch()
    assert other.weights("georm") == trained
    assert other.weights("finish") == shipped.weights("finish")


def test_layouts_of_known_sets(tmp_path):
    (tmp_path / "MUG" / "meshes").mkdir(parents=True)
    (tmp_path / "MUG" / "meshes" / "model.obj").touch()
    (tmp_path / "MUG" / "thumbnails").mkdir()
    (tmp_path / "MUG" / "thumbnails" / "0.jpg").touch()
    for number in range(7):
        (tmp_path / "apple" / f"apple_{number:03d}" / "Scan").mkdir(parents=True)
        (tmp_path / "apple" / f"apple_{number:03d}" / "Scan" / "Scan.obj").touch()
    (tmp_path / "chair.glb").touch()
    (mug,) = evaluation_entries(tmp_path, "gso", "eval", None)
    assert mug.name == "MUG" and mug.picture.name == "0.jpg" and not mug.has_material
    apples = evaluation_entries(tmp_path, "omniobject3d", "eval", None)
    assert [apple.name for apple in apples] == [f"apple_{number:03d}" for number in range(5)]
    (tmp_path / "apple").rename(tmp_path / "rest")
    with pytest.raises(ArmError, match="one name"):  # Seven files Scan.obj.
        evaluation_entries(tmp_path, "folder", "eval", None)
    with pytest.raises(ArmError, match="--data"):
        evaluation_entries(None, "gso", "eval", None)
    with pytest.raises(ArmError, match="no object"):
        evaluation_entries(tmp_path / "MUG", "omniobject3d", "eval", None)


def test_a_spread_takes_of_every_set(tmp_path):
    entries = [EvaluationEntry(f"{kind}{k}", tmp_path, kind) for kind in ("gso", "pbr") for k in range(9)]
    chosen = spread(entries, 6)
    assert [entry.kind for entry in chosen] == ["gso"] * 3 + ["pbr"] * 3
    assert len({entry.name for entry in chosen}) == 6


def test_the_mesh_of_an_object_is_the_only_one_of_its_name(tmp_path):
    (tmp_path / "cup").mkdir()
    with pytest.raises(ArmError, match="cup.glb"):
        mesh_of(tmp_path, "cup")
    (tmp_path / "cup" / "model.glb").touch()
    assert mesh_of(tmp_path, "cup").name == "model.glb"
    (tmp_path / "cup" / "other.obj").touch()
    with pytest.raises(ArmError, match="2 meshes"):
        mesh_of(tmp_path, "cup")
    (tmp_path / "cup.glb").touch()
    assert mesh_of(tmp_path, "cup").name == "cup.glb"


def test_test_views_are_none_of_the_inputs():
    protocol = Protocol(resolution=32)
    tests, inputs = protocol.tests(), protocol.inputs()
    assert len(tests) == 8
    for camera in (*tests, *inputs, protocol.front()):
        assert float(camera.center.norm()) == pytest.approx(6.0, abs=1e-4)
    nearest = min(float((a.center - b.center).norm()) for a in tests for b in inputs)
    assert nearest > 0.5
    heights = [math.degrees(math.asin(float(camera.center[2]) / 6.0)) for camera in tests]
    assert heights == pytest.approx([-15.0, 0.0, 15.0, 35.0] * 2, abs=1e-3)


@pytest.mark.parametrize(
    ("words", "named"),
    [(["--also", "ablation"], "NAME=DIR"), (["--weights", "nowhere"], "nowhere"), (["--ids", "cup"], "cup")],
)
def test_words_that_do_not_do_are_one_line(tmp_path, capsys, words, named):
    objects = [{"id": "jug", "set": "pbr", "split": "eval", "main": "jug.glb", "attribution": "", "licence": "CC0-1.0"}]
    (tmp_path / "manifest.json").write_text(json.dumps({"objects": objects}))
    assert main(["evaluate", "--data", str(tmp_path), "--output", str(tmp_path / "out"), *words]) == 1
    assert named in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_run_goes_on_with_what_is_of_the_same_trial(tmp_path):
    lost = result("lost", 0.2, 0.5)
    lost.systems[OURS] = SystemResult(FAILED, None, 0.0, {"lit": MISSED})
    results = [result("a", 0.9, 0.5), result("b", 0.8, 0.5, "gso"), lost]
    trial = Trial(Settings(), Protocol())
    assert kept_results(tmp_path, trial) == {}
    write_tables(tmp_path, results, Cost(math.nan, 2.0, 10.0), trial, "python -m training evaluate")
    assert kept_results(tmp_path, trial) == {item.name: item for item in results}
    for other in (replace(trial, seed=1), replace(trial, settings=Settings(quality="draft"))):
        assert kept_results(tmp_path, other) == {}
    (tmp_path / "results.json").write_text("{}")
    assert kept_results(tmp_path, trial) == {}
