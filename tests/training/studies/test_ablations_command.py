"""`python -m training ablations`: what it fits, what it keeps, and what its tables say."""

import json

import pytest

from arm_blender import pipeline
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, RelightableAsset
from training.__main__ import main
from training.evaluation.scores.alignment import AlignmentConfig
from training.evaluation.trials.trial import Trial
from training.evaluation.truth.protocol import Protocol
from training.run_record import RunRecord
from training.studies import ablated_albedo, ablations
from training.studies.ablated_albedo import ABLATIONS
from training.studies.ablations import ROWS, WHOLE, system


@pytest.fixture
def fits(monkeypatch) -> list:
    """The arguments of every fit, which leaves an empty file of weights."""
    asked = []

    def fit(start, samples, output, config, settings, record) -> None:
        asked.append((start, samples, config, settings))
        output.parent.mkdir(parents=True, exist_ok=True)
        output.touch()
        numbers = {"albedo": 14.0, "blend as albedo": 13.0}
        for step in (1, config.steps):
            RunRecord.beside(output, {}).scalars(step, "validation", {k: step * v for k, v in numbers.items()})

    monkeypatch.setattr(ablated_albedo.instant_albedo, "fit", fit)
    return asked


@pytest.fixture
def command(ball_data, ball_asset, fits, monkeypatch):
    """The command on a set of one ball: with half of the albedo where no measurements are seen."""
    (ball_data / "shards" / "cup").mkdir(parents=True)
    for path in (ball_data / "shards" / "cup" / "rig_0.npz", ball_data / "cup.rig_0.npz", ball_data / "cup.rig_1.npz"):
        path.touch()

    def generate(views, settings, mesh=None):
        maps, folder = ball_asset.maps, settings.weights_folder
        if folder is not None and folder.name == "no-measurements":
            maps = MaterialMaps(0.5 * maps.albedo, maps.baked, maps.roughness, maps.metallic)
        return RelightableAsset("ball", ball_asset.mesh, maps), Report("small", "cpu", 0)

    def trial(*args, **changes) -> Trial:
        alignment = AlignmentConfig(scales=(1.0,), points=300, refined=1, rounds=5)
        return Trial(*args, points=5_000, alignment=alignment, **changes)

    monkeypatch.setattr(pipeline, "generate", generate)
    monkeypatch.setattr(ablations.atlases, "prepare", lambda shards, cache: 2)
    monkeypatch.setattr(ablations, "Trial", trial)
    monkeypatch.setattr(ablations, "PROTOCOL", Protocol(resolution=64, views=4))
    words = ["--shards", ball_data / "shards", "--cache", ball_data, "--data", ball_data, "--output", ball_data / "out"]
    words += ["--truth", ball_data / "truth", "--steps", "3"]
    return ["ablations", *map(str, words)]


def test_all_are_fitted_alike_once(command, fits, ball_data, capsys):
    assert main(command) == 0
    assert [getattr(start.config, "ablation", WHOLE) for start, *_ in fits] == list(ROWS)
    assert all(arguments[1:] == fits[0][1:] for arguments in fits)
    assert {config.steps for _, _, config, _ in fits} == {3}
    fits.clear()
    assert main(command) == 0 and fits == []  # Nothing is left to do.
    assert main([*command, "--steps", "4"]) == 0
    assert len(fits) == len(ROWS)  # Another budget is another run.


def rows(text: str) -> dict[str, list[str]]:
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    return {line[0]: line[1:] for line in cells}


def test_the_tables_say_what_was_measured(command, ball_data, capsys):
    document = ball_data / "ablations.md"
    document.write_text("<!-- instant_albedo:begin -->\n<!-- instant_albedo:end -->\n")
    assert main([*command, "--update-document", str(document)]) == 0
    text = document.read_text()
    assert "2 samples of 1 objects" in text and text.count("Measured on 1 objects") == 1
    found = rows(text)
    assert set(ROWS.values()) <= found.keys()
    whole, blind = found[ROWS[WHOLE]], found[ROWS["no-measurements"]]
    assert whole == ["42.00", "50.00", *whole[2:5], "-"] and float(blind[1]) < 20.0 and blind[-1] == "0 of 1"
    assert blind[2:5] == whole[2:5]  # Right but for its scale; roughness and metallic are the same.
    # Of held-out objects what the fit's last validation said.
    assert found["*no network*"][0] == "39.00" and found["*as shipped, from a longer training*"][0] == "-"
    record = json.loads((ball_data / "out" / "evaluation-instant_albedo" / "results.json").read_text())
    assert {system(name) for name in ROWS} <= record["objects"][0]["systems"].keys()


def test_fits_are_compared_by_their_own_validation_where_nothing_is_measured(command, ball_data, capsys):
    assert main([*command, "--limit", "0"]) == 0
    text = (ball_data / "out" / "instant_albedo.md").read_text()
    found = rows(text)
    assert found["InstantAlbedo"] == ["held out: albedo"] and found["*no network*"] == ["39.00"]
    assert found[ROWS[WHOLE]] == ["42.00"] and "Nothing else was measured" in text


def test_every_ablation_of_the_network_has_a_row():
    assert {WHOLE, *ABLATIONS} == set(ROWS)
