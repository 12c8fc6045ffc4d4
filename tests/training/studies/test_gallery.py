"""The gallery shows what went in, the asset in three lights and its maps, and says who made the object."""

import json
from dataclasses import replace

import pytest
import torch
from PIL import Image

from arm_blender.errors import ArmError
from arm_blender.export import write_asset
from arm_blender.report import Report
from arm_blender.structures import Regions
from arm_blender.uv.finish import chosen_finishes
from arm_blender.views.image_io import write_png
from training.evaluation.trials.capture_trial import REFUSED, Answer

pytestmark = pytest.mark.blender


@pytest.fixture
def gallery(monkeypatch):
    from training.studies import gallery_blender

    monkeypatch.setattr(gallery_blender, "TURNS", 3)
    monkeypatch.setattr(gallery_blender, "SIDE", 32)
    return gallery_blender


@pytest.fixture
def views(tmp_path):
    folder = tmp_path / "ball"
    folder.mkdir()
    for k in range(6):
        write_png(folder / f"{k:03d}.png", torch.rand(4, 24, 32), srgb=True)
    return folder


def test_the_page_has_a_row_a_credit_and_a_turn(gallery, views, ball_asset, tmp_path):
    from training import __main__ as command

    report = Report("small", "cpu", 0, name="ball", charts=ball_asset.mesh.charts)
    one = Regions(torch.ones(64, 64, dtype=torch.uint8), (1.0,), ((0.5, 0.5, 0.5),), (1.0, 1.0, 1.0))
    maps = chosen_finishes(replace(ball_asset.maps, regions=one), None, report)
    write_asset(replace(ball_asset, maps=maps), report, tmp_path / "out" / "ball")
    entry = {"id": "ball", "attribution": "A. Nybody", "licence": "CC0-1.0"}
    (tmp_path / "manifest.json").write_text(json.dumps({"objects": [entry]}))
    page = tmp_path / "docs" / "gallery.md"
    page.parent.mkdir()
    page.write_text("<!-- gallery:begin -->\n<!-- gallery:end -->\n")
    words = ["gallery", str(views), "--data", str(tmp_path), "--output", str(tmp_path / "out"), "--samples", "1"]
    words += ["--pictures", str(page.parent / "images"), "--document", str(page)]
    assert command.main([*words, "--turntable", str(tmp_path / "turn.webp")]) == 0
    assert "](images/ball.jpg)" in page.read_text() and "A. Nybody, CC0-1.0" in page.read_text()
    with Image.open(page.parent / "images" / "ball.jpg") as row:
        assert row.width == 9 * gallery.TILE  # Three pictures, three lights, three maps.
    with Image.open(tmp_path / "turn.webp") as turn:
        assert turn.n_frames == 6 and turn.size == (32, 32)


def test_maps_are_those_of_the_object_wherever_it_lies(gallery, ball_asset):
    maps = gallery.maps_of(ball_asset)
    far = replace(ball_asset, mesh=ball_asset.mesh.moved(lambda points: 7.0 * points + 3.0))
    for name, picture in gallery.maps_of(far).items():
        assert float((picture - maps[name]).abs().mean()) < 2e-3
        middle = picture[:, 150:234, 150:234]
        assert 0.02 < float(middle.mean()) < 0.95 and float(picture[:, 0, 0].min()) == 1.0


def test_what_cannot_be_made_is_named(gallery, views, tmp_path, monkeypatch):
    monkeypatch.setattr(gallery, "answer", lambda *_: Answer(REFUSED, "no pictures", 0.0, 0.0))
    with pytest.raises(ArmError, match="ball: no asset .no pictures."):
        gallery.made(gallery.Item(views, "ball"), tmp_path / "out", "draft")
