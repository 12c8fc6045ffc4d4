"""The check of a GPU, tried on the processor: what differs fails, what breaks is told, and a stage goes on."""

from dataclasses import replace

import pytest
import torch

from training import __main__ as command
from training.studies import gpu_check


@pytest.fixture
def in_this_process(monkeypatch):
    monkeypatch.setattr(gpu_check, "in_own_process", lambda part, check: part(check))


@pytest.mark.long
@pytest.mark.parametrize("name", ["georm-volume", "glossyrm", "material-prior", "instant-albedo"])
def test_a_stage_takes_a_step_and_another_after_a_resume(in_this_process, one_thread, tmp_path, capsys, name):
    words = ["check-gpu", "--device", "cpu", "--output", str(tmp_path / "out"), "--parts", name]
    assert command.main(words) == 0
    assert f"| {name} | passed |" in capsys.readouterr().out
    resume = tmp_path / "out" / name / "weights.resume"
    assert torch.load(resume, weights_only=True)["step"] == 2


def test_maps_that_differ_fail(ball_asset):
    maps = ball_asset.maps
    assert min(gpu_check.alike(maps, maps).values()) >= gpu_check.MAPS
    other = gpu_check.alike(replace(maps, metallic=maps.metallic + 0.02), maps)
    assert other["metallic"] < gpu_check.MAPS <= other["albedo"]


def test_a_part_that_breaks_is_told_and_the_others_run(monkeypatch, tmp_path, capsys):
    good = {"found": "all well", "passed": True, "seconds": 1.0, "gib": 2.0}
    results = iter([{"found": "RuntimeError: no", "passed": False}, good, {"skipped": "no bpy"}])
    monkeypatch.setattr(gpu_check, "in_own_process", lambda part, check: next(results))
    document = tmp_path / "cost.md"
    document.write_text("<!-- gpu:begin -->\n<!-- gpu:end -->\n")
    monkeypatch.setattr(gpu_check, "DOCUMENT", document)
    words = ["--output", str(tmp_path / "out"), "--parts", "demo", "glossyrm", "cycles", "--update"]
    assert command.main(["check-gpu", "--device", "cpu", *words]) == 1
    text = document.read_text()
    assert "| demo | FAILED | RuntimeError: no | - | - |" in text
    assert "| glossyrm | passed | all well | 1.00 | 2.00 |" in text and "| cycles | skipped | no bpy |" in text
    assert "ever run on a GPU" in text


def test_a_folder_that_is_not_its_own_is_kept(tmp_path, capsys):
    (tmp_path / "precious").touch()
    assert command.main(["check-gpu", "--device", "cpu", "--output", str(tmp_path)]) == 1
    assert (tmp_path / "precious").exists() and "another --output" in capsys.readouterr().err
