"""Six views of one picture, drawn on the way to its asset; Zero123++ is played by a stand-in."""

import json
from pathlib import Path

import pytest
import torch

from arm_blender.export import is_whole

from ..pictures import a_picture
from .command_line import MULTIVIEW, only_line, run


@pytest.fixture
def drawn(monkeypatch) -> list:
    """Stands in for Zero123++: six views of a block on grey; keeps how it was asked."""
    from arm_blender.views.zero123plus import provider

    calls = []

    def six_views(networks, picture, config, noise, progress):
        calls.append((config, noise.seeds))
        progress(0.5, "drawing")
        views = torch.full((6, 3, config.side, config.side), 0.5)
        views[:, 0, 80:240, 80:240] = 0.9
        return views

    for name in ("check_model", "load_networks"):
        monkeypatch.setattr(provider, name, lambda *_: None)
    monkeypatch.setattr(provider, "six_views", six_views)
    return calls


def test_the_six_views_of_a_picture_are_written_and_taken(pipeline, drawn, picture, tmp_path):
    words = "--multiview-steps 75 --multiview-guidance 3 --multiview-background white --seed 5 --threads 2"
    out = tmp_path / "out"
    assert run("generate", picture, "--output", out, *MULTIVIEW, *words.split()) == 0
    (config, seeds), (views, _) = drawn[0], pipeline[0]
    assert (config.model, config.steps, config.guidance, config.background) == (Path("weights"), 75, 3.0, "white")
    assert (config.device, config.threads, seeds) == ("cpu", 2, (5,) * 6)
    assert views.name == "cup" and views.images.shape == (6, 4, 320, 320)
    assert is_whole(out) and len(list((out / "views").glob("*.png"))) == 6
    assert run("generate", out / "views", "--output", tmp_path / "again") == 0
    assert torch.equal(pipeline[1][0].images, views.images)


def test_views_that_are_given_are_not_drawn_and_the_report_says_so(pipeline, drawn, picture, tmp_path):
    out = tmp_path / "out"
    assert run("generate", picture, "--output", out, *MULTIVIEW) == 0
    for views in (out / "views", out / "views" / "transforms.json"):
        assert run("generate", views, "--output", tmp_path / "again", *MULTIVIEW, "--reseed", "2") == 0
        notes = json.loads((tmp_path / "again" / "report.json").read_text())["left_out"]
        assert "--multiview zero123plus" in [note["what"] for note in notes]
    assert len(drawn) == 1


def test_one_view_is_drawn_anew_by_its_number(pipeline, drawn, picture, tmp_path):
    out = tmp_path / "out"
    assert run("generate", picture, "--output", out, *MULTIVIEW) == 0
    assert run("generate", picture, "--output", out, *MULTIVIEW, "--reseed", "1,4", "--seed", "9") == 0
    assert [seeds for _, seeds in drawn] == [(0,) * 6, (0, 9, 0, 0, 9, 0)]


def test_missing_multiview_weights_are_one_line(pipeline, picture, tmp_path, capsys):
    words = ["--multiview", "zero123plus", "--multiview-model", tmp_path / "gone"]
    assert run("generate", picture, "--output", tmp_path / "out", *words) == 1
    assert "gone: no such folder" in only_line(capsys.readouterr().err)
    assert not (tmp_path / "out").exists() and pipeline == []


def test_each_item_of_a_batch_has_its_own_six_views(pipeline, drawn, tmp_path, capsys):
    a_picture(tmp_path / "a.png")
    a_picture(tmp_path / "b.png")
    (tmp_path / "list.csv").write_text("views,seed\na.png,1\nb.png,2\n")
    assert run("batch", tmp_path / "list.csv", "--output", tmp_path / "out", *MULTIVIEW) == 0
    assert [(config.folder.parent.name, seeds[0]) for config, seeds in drawn] == [("a", 1), ("b", 2)]
