"""Generated tables: numbers land in the right block, credit reaches everyone who asks for it, counts add up."""

import functools
import json
from pathlib import Path

import pytest

from arm_blender.errors import ArmError, OutputError
from arm_blender.quality_levels import FILE
from training.__main__ import main
from training.documents import fill_block, markdown_table
from training.evaluation.truth.objects import evaluation_objects
from training.rendering.manifest import read_manifest
from training.studies import presets
from training.studies.credits import sources
from training.studies.quality_levels import levels


def test_a_table_aligns_numbers_and_keeps_bars_inside_their_cells():
    lines = markdown_table(["name", "count", "share"], [["a|b", 1200, 0.5], ["c", 7, -0.25]]).splitlines()
    assert lines == [
        "| name | count | share |",
        "| --- | ---: | ---: |",
        "| a\\|b | 1,200 | 0.500 |",
        "| c | 7 | -0.250 |",
    ]


def test_filling_a_block_replaces_it_and_nothing_else(tmp_path):
    document = tmp_path / "README.md"
    document.write_text("before\n<!-- results:begin -->\nold\n<!-- results:end -->\nafter\n")
    fill_block(document, "results", "new")
    assert document.read_text() == "before\n<!-- results:begin -->\nnew\n<!-- results:end -->\nafter\n"
    once = document.read_text()
    fill_block(document, "results", "new")
    assert document.read_text() == once


@pytest.mark.parametrize("text", ["", "<!-- results:begin -->", "<!-- results:end --><!-- results:begin -->"])
def test_a_document_without_the_block_is_left_as_it_was(tmp_path, text):
    document = tmp_path / "README.md"
    document.write_text(text)
    with pytest.raises(OutputError, match="results:begin"):
        fill_block(document, "results", "new")
    assert document.read_text() == text


def test_credit_goes_to_all_who_ask_for_it_and_to_no_object_of_the_eval_split(tmp_path):
    def entry(name: str, licence: str, split: str) -> dict:
        return {"id": name, "attribution": f"{name} by maker of {name} - site", "licence": licence, "split": split}

    manifest = {
        "objects": [
            entry("cup", "CC-BY-4.0", "train"),
            entry("jug", "MIT", "train"),
            entry("pot", "CC0-1.0", "train"),
            entry("pan", "CC-BY-4.0", "eval"),
        ],
        "textures": [{"id": "bark", "attribution": "ambientCG (site) Bark", "licence": "CC0-1.0"}],
        "hdris": [],
    }
    text = sources(manifest)
    assert all(f"| {name} | {name} by maker of {name} - site |" in text for name in ("cup", "jug"))
    assert "maker of pot (1)" in text and "ambientCG (1)" in text
    assert "pan" not in text

    data = tmp_path / "manifest.json"
    data.write_text(json.dumps(manifest))
    document = tmp_path / "CREDITS.md"
    document.write_text("<!-- sources:begin --><!-- sources:end -->")
    assert main(["credits", "--data", str(tmp_path), "--output", str(document)]) == 0
    assert text in document.read_text()

    (tmp_path / "more").mkdir()
    more = {"objects": [entry("mug", "CC-BY-4.0", "train")], "textures": [], "hdris": []}
    (tmp_path / "more" / "manifest.json").write_text(json.dumps(more))
    words = ["--data", str(tmp_path), "--more", str(tmp_path / "more"), "--output", str(document)]
    assert main(["credits", *words]) == 0
    assert all(f"| {name} | {name} by" in document.read_text() for name in ("cup", "mug"))


def test_a_missing_manifest_is_named(tmp_path, capsys):
    assert main(["credits", "--data", str(tmp_path)]) == 1
    assert f"{tmp_path}/manifest.json" in capsys.readouterr().err


network_parameters = functools.cache(presets.network_parameters)


def test_the_page_of_the_method_states_the_sizes_of_the_networks(monkeypatch):
    monkeypatch.setattr(presets, "network_parameters", network_parameters)
    assert presets.presets_table() in (Path(__file__).parents[3] / "docs" / "method.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("preset", ["paper", "small"])
def test_the_parts_of_a_network_add_up_to_it(preset):
    counts = network_parameters(preset)["georm"]
    assert sum(count for part, count in counts.items() if part) == counts[""]


def test_the_papers_transformer_has_the_size_of_the_published_one():
    # InstantMesh's transformer has 263.7 M parameters, of which its deconvolution to 80 channels is not in ours.
    assert network_parameters("paper")["georm"]["transformer"] == pytest.approx(263.7e6 - 1024 * 80 * 4, rel=2e-4)


def test_an_object_without_views_is_named_and_not_left_out_of_the_mean(tmp_path):
    manifest = {"objects": [{"id": name, "set": "gso", "split": "eval"} for name in ("cup", "jug")]}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    (tmp_path / "views" / "cup").mkdir(parents=True)
    (tmp_path / "views" / "cup" / "transforms.json").write_text("{}")
    with pytest.raises(ArmError, match="jug"):
        evaluation_objects(tmp_path / "views", tmp_path)
    assert [item.name for item in evaluation_objects(tmp_path / "views")] == ["cup"]


@pytest.mark.parametrize("text", ["", "[]", '{"objects": 3}'])
def test_what_is_no_manifest_is_named(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(ArmError, match=r"manifest\.json: .*--data"):
        read_manifest(tmp_path)
    with pytest.raises(ArmError, match="ARM_DATA"):
        read_manifest(None)


def test_the_panels_levels_are_those_of_the_sweep():
    """Fails where docs/error-and-time.csv is newer: run `python -m training quality-levels`."""
    assert json.loads(FILE.read_text()) == levels(Path(__file__).parents[3] / "docs" / "error-and-time.csv")


@pytest.mark.parametrize("text", ["", "label,chamfer\ndraft,0.1\n", None])
def test_a_sweep_without_the_levels_is_one_line(tmp_path, capsys, text):
    sweep = tmp_path / "sweep.csv"
    if text is not None:
        sweep.write_text(text)
    assert main(["quality-levels", "--sweep", str(sweep), "--output", str(tmp_path / "levels.json")]) == 1
    assert "sweep.csv" in capsys.readouterr().err and not (tmp_path / "levels.json").exists()
