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
from training.studies.ablations import ALBEDO, SHAPE, STUDIES, WHOLE


@pytest.fixture
def fits(monkeypatch) -> list:
    """The arguments of every fit, which leaves an empty file of weights."""
    asked = []

    def leave(output, steps: int) -> None:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.touch()
        numbers = {"albedo": 14.0, "blend as albedo": 13.0, "iou": 0.6, "hull iou": 0.5}
        for step in (1, steps):
            RunRecord.beside(output, {}).scalars(step, "validation", {k: step * v for k, v in numbers.items()})

    def fit(start, samples, output, config, settings, record) -> None:
        asked.append((start, samples, config, settings))
        leave(output, config.steps)

    def run(args) -> int:
        asked.append(args)
        leave(args.output, args.steps)
        return 0

    monkeypatch.setattr(ablated_albedo.instant_albedo, "fit", fit)
    monkeypatch.setattr(SHAPE.stage, "run", run)
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
        shape = ball_asset.mesh
        if folder is not None and folder.name == "no-pixel-aligned":
            shape = shape.moved(lambda vertices: 0.5 * vertices)
        return RelightableAsset("ball", shape, maps), Report("small", "cpu", 0)

    def trial(*args, **changes) -> Trial:
        alignment = AlignmentConfig(scales=(1.0,), points=300, refined=1, rounds=5)
        return Trial(*args, points=5_000, alignment=alignment, **changes)

    monkeypatch.setattr(pipeline, "generate", generate)
    monkeypatch.setattr(ablations.atlases, "prepare", lambda shards, cache: 2)
    monkeypatch.setattr(ablations, "Trial", trial)
    monkeypatch.setattr(ablations, "PROTOCOL", Protocol(resolution=64, views=4))
    words = ["--shards", ball_data / "shards", "--cache", ball_data, "--data", ball_data, "--output", ball_data / "out"]
    words += ["--truth", ball_data / "truth", "--steps", "3", "--georm-steps", "2"]
    return ["ablations", *map(str, words)]


def test_all_are_fitted_alike_once(command, fits, ball_data, capsys):
    assert main(command) == 0
    albedo, shape = fits[: len(ALBEDO.rows)], fits[len(ALBEDO.rows) :]
    assert [getattr(start.config, "ablation", WHOLE) for start, *_ in albedo] == list(ALBEDO.rows)
    assert [args.no_pixel_aligned for args in shape] == [False, True]
    alike = [{k: v for k, v in vars(a).items() if k not in ("output", "no_pixel_aligned")} for a in shape]
    assert all(arguments == alike[0] for arguments in alike)
    assert all(arguments[1:] == albedo[0][1:] for arguments in albedo)
    assert {config.steps for _, _, config, _ in albedo} == {3} and {args.steps for args in shape} == {2}
    fits.clear()
    assert main(command) == 0 and fits == []  # Nothing is left to do.
    assert main([*command, "--steps", "4"]) == 0
    assert len(fits) == len(ALBEDO.rows)  # Another budget is another run.


def rows(text: str) -> dict[str, list[str]]:
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    return {line[0]: line[1:] for line in cells}


def test_the_tables_say_what_was_measured(command, ball_data, capsys):
    document = ball_data / "ablations.md"
    document.write_text("".join(f"<!-- {name}:begin -->\n<!-- {name}:end -->\n" for name in STUDIES))
    assert main([*command, "--update-document", str(document)]) == 0
    text = document.read_text()
    assert "2 samples of 1 objects" in text and "1 rigs of 1 objects" in text
    assert text.count("Measured on 1 objects") == 2
    albedo, _, shape = text.partition("| GeoRM ")
    found = rows(albedo)
    assert set(ALBEDO.rows.values()) <= found.keys()
    whole, blind = found[ALBEDO.rows[WHOLE]], found[ALBEDO.rows["no-measurements"]]
    assert whole == ["42.00", "50.00", *whole[2:5], "-"] and float(blind[1]) < 20.0 and blind[-1] == "0 of 1"
    assert blind[2:5] == whole[2:5]  # Right but for its scale; roughness and metallic are the same.
    # Of held-out objects what the fit's last validation said.
    assert found["*no network*"][0] == "39.00" and found["*as shipped, from a longer training*"][0] == "-"
    shapes = rows("| GeoRM " + shape)
    assert shapes[SHAPE.rows[WHOLE]][:2] == ["1.200", "1.000"] and shapes["*no network*"][0] == "1.000"
    assert float(shapes[SHAPE.rows["no-pixel-aligned"]][1]) == 0.0
    record = json.loads((ball_data / "out" / "evaluation-instant_albedo" / "results.json").read_text())
    assert {ALBEDO.system(name) for name in ALBEDO.rows} <= record["objects"][0]["systems"].keys()


def test_fits_are_compared_by_their_own_validation_where_nothing_is_measured(command, ball_data, capsys):
    assert main([*command, "--limit", "0", "--networks", "georm"]) == 0
    text = (ball_data / "out" / "georm.md").read_text()
    found = rows(text)
    assert found["GeoRM"] == ["held out: iou"] and found["*no network*"] == ["1.000"]
    assert found[SHAPE.rows[WHOLE]] == ["1.200"] and "Nothing else was measured" in text
    assert not (ball_data / "out" / "instant_albedo.md").exists()


def test_a_fit_that_leaves_no_weights_is_an_error(command, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(SHAPE.stage, "run", lambda args: 0)
    assert main(command) == 1
    assert "small.georm.safetensors: was not fitted" in capsys.readouterr().err
    assert not (tmp_path / "out" / "georm.md").exists()


def test_every_ablation_of_the_network_has_a_row():
    assert {WHOLE, *ABLATIONS} == set(ALBEDO.rows)
