"""The cost of a step at the paper's sizes: shapes without content count as content does, and runs are made once."""

import json
from dataclasses import asdict

import pytest
import torch

from arm_blender.models.paper.georm import GeoRM
from training import __main__ as command
from training.kept_memory import kept_by
from training.studies import paper_step
from training.studies.paper_step import Run, kept_without_memory, run_step


def test_tensors_without_content_count_as_those_with(plane_network):
    """Attention among it: its matrix is not kept."""

    def prepare():
        images, camera = torch.rand(1, 2, 4, 32, 32), torch.rand(1, 2, 4, 4)
        views = paper_step.NetworkViews(images, torch.rand(1, 2, 2, 32, 32), camera, torch.rand(1, 2, 3, 3))
        return lambda model: model.encode(views).planes.sum()

    torch.manual_seed(0)
    model, loss = GeoRM(plane_network), prepare()
    with kept_by(model) as kept:
        loss(model)
    found = kept_without_memory(lambda: GeoRM(plane_network), prepare, False)
    assert found == pytest.approx(kept.bytes, rel=0.02)
    assert kept_without_memory(lambda: GeoRM(plane_network), prepare, True) < found


@pytest.mark.parametrize("name", paper_step.RUNS)
def test_each_stage_takes_its_step_on_the_made_up_object(monkeypatch, plane_network, name):
    """At a test's size: all weights get finite gradients, and with GeoRM's ball there is a surface."""
    monkeypatch.setattr(paper_step, "PAPER", plane_network)
    views = paper_step.inputs()
    small = paper_step.NetworkViews(views.images[..., :32, :32], views.silhouette, views.c2w, views.K)
    monkeypatch.setattr(paper_step, "inputs", lambda: small)
    few = paper_step.georm_surface.SurfaceConfig(grid=32, side=48, views=2)
    monkeypatch.setattr(paper_step.georm_surface, "SurfaceConfig", lambda: few)
    glossy = paper_step.glossyrm.GlossyConfig(grid=32, side=48, views=2)
    monkeypatch.setattr(paper_step.glossyrm, "GlossyConfig", lambda: glossy)
    sampling = paper_step.georm_volume.SamplingConfig(8, 8)
    volume = paper_step.georm_volume.VolumeConfig(sampling, views=2)
    monkeypatch.setattr(paper_step.georm_volume, "VolumeConfig", lambda: volume)
    found = run_step(name)
    assert found.kept > 0 and found.seconds > 0.0


def test_a_run_that_is_known_is_not_made_again(tmp_path, monkeypatch, capsys):
    path, made = tmp_path / "runs.json", []
    known = Run(1.0, 2.0, 3 * paper_step.GIB, "nothing")
    path.write_text(json.dumps({"glossyrm": asdict(known)}))

    def run_elsewhere(name: str) -> Run:
        made.append(name)
        return known

    monkeypatch.setattr(paper_step, "in_own_process", run_elsewhere)
    monkeypatch.setattr(paper_step, "kept_without_memory", lambda *step: paper_step.GIB)
    monkeypatch.setattr(paper_step, "DOCUMENT", tmp_path / "cost.md")
    (tmp_path / "cost.md").write_text("<!-- steps:begin -->\n<!-- steps:end -->\n")
    for _ in range(2):
        assert command.main(["paper-step", "--runs", str(path), "--update-document"]) == 0
    assert made == ["georm-volume", "georm-surface"]
    row = "| glossyrm | 429.9 M | 8.0 | 3.00 | 3.00 | 1 s, 2.0 GiB, nothing |"
    assert row in capsys.readouterr().out and row in (tmp_path / "cost.md").read_text()
