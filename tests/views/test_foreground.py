"""The first way that is sure cuts the object out, and when none is, one line says what to do."""

from pathlib import Path

import pytest
import torch

from arm_blender.errors import CheckpointError, InputImageError
from arm_blender.report import Report
from arm_blender.views import load_views
from arm_blender.views.foreground import WAYS, foreground
from arm_blender.views.image_io import write_png
from arm_blender.views.masks import Unsure
from arm_blender.views.preprocess import FOREGROUND_RATIO
from arm_blender.weight_files import checkpoints

PATH = Path("folder/mug.png")


@pytest.fixture
def orange() -> torch.Tensor:
    """A square on white, opaque."""
    image = torch.ones(4, 100, 140)
    image[:3, 30:70, 50:90] = torch.tensor([0.8, 0.2, 0.0])[:, None, None]
    return image


def doubting(image):
    raise Unsure("it is foggy")


def test_alpha_that_is_there_is_kept(orange, weights_folder):
    heard = []
    orange[3, :10] = 0.2
    assert foreground(orange, PATH, lambda *words: heard.append(words)) is orange
    assert heard == [("mug.png", "alpha")]


def test_the_first_way_that_is_sure_is_taken(orange, monkeypatch):
    half = torch.zeros(100, 140)
    half[:50, :70] = 0.9
    calls = []
    monkeypatch.setitem(WAYS, "matting model", doubting)
    monkeypatch.setitem(WAYS, "rembg", lambda image: half)
    monkeypatch.setitem(WAYS, "plain background", calls.append)
    heard = []
    found = foreground(orange, PATH, lambda *words: heard.append(words))
    assert torch.equal(found[3], half) and torch.equal(found[:3], orange[:3])
    assert heard == [("mug.png", "rembg")] and calls == []


def test_a_mask_in_shreds_is_refused_and_said(orange, monkeypatch):
    shredded = torch.zeros(100, 140)
    for row in range(0, 100, 20):
        shredded[row : row + 10, ::20] = shredded[row : row + 10, 1::20] = 1.0
    monkeypatch.setitem(WAYS, "matting model", lambda image: shredded)
    heard = []
    foreground(orange, PATH, lambda *words: heard.append(words))
    assert heard[0] == ("mug.png", "plain background"), "the next way is asked"
    monkeypatch.setitem(WAYS, "plain background", doubting)
    monkeypatch.setitem(WAYS, "small network", doubting)
    with pytest.raises(InputImageError, match=r"matting model found is no object: it is in 35 pieces.*mug\.mask\.png"):
        foreground(orange, PATH)


def test_a_doubtful_mask_is_taken_and_said_to_be_doubtful(orange, monkeypatch):
    torn = torch.zeros(100, 140)
    torn[30:70, 20:60], torn[30:70, 60:120] = 0.9, 0.6
    monkeypatch.setitem(WAYS, "matting model", lambda image: torn)
    heard = []
    assert torch.equal(foreground(orange, PATH, lambda *words: heard.append(words))[3], torn)
    assert heard == [("mug.png", "matting model"), ("mug.png", "doubtful: how far the object reaches is not certain")]


def test_all_or_nothing_is_no_object(orange, monkeypatch):
    monkeypatch.setitem(WAYS, "matting model", lambda image: torch.ones(100, 140))
    monkeypatch.setitem(WAYS, "rembg", lambda image: torch.zeros(100, 140))
    heard = []
    foreground(orange, PATH, lambda *words: heard.append(words))
    assert heard == [("mug.png", "plain background")]


def test_when_no_way_is_sure_one_line_has_the_doubts_and_the_remedies(orange, monkeypatch):
    for way in WAYS:
        monkeypatch.setitem(WAYS, way, doubting)
    with pytest.raises(InputImageError) as caught:
        foreground(orange, PATH)
    line = str(caught.value)
    assert line.startswith("folder/mug.png: no foreground found (it is foggy")
    assert all(word in line for word in ("alpha", "plain background", "weights download matting"))


def test_a_damaged_model_is_not_passed_over(orange, weights_folder):
    checkpoints.shipped("matting").write_bytes(b"no model")
    with pytest.raises(CheckpointError, match="matting.onnx"):
        foreground(orange, PATH)


def test_the_report_says_how_a_photograph_was_cut_out_and_the_crop_is_the_rigs(
    orange, weights_folder, matting_model, tmp_path
):
    """By a model that knows red, before a ground that is not plain; the object fills its share of the crop."""
    orange[1:3] *= torch.rand(2, 100, 140, generator=torch.Generator().manual_seed(0))
    orange[0] *= torch.where(orange[1] > 0.3, 0.1, 1.0)
    orange[:3, 30:70, 50:90] = torch.tensor([0.8, 0.0, 0.0])[:, None, None]
    orange[:3, :30] = torch.tensor([0.0, 0.3, 0.6])[:, None, None]
    write_png(tmp_path / "cup.png", orange, srgb=True)
    matting_model(checkpoints.shipped("matting"))
    report = Report("small", "cpu", 0)
    views = load_views(tmp_path / "cup.png", heard=report.note_mask)
    assert report.as_dict()["masks"] == {"matting model": ["cup.png"]}
    alpha = views.images[0, 3] > 0.5
    rows, columns = torch.nonzero(alpha, as_tuple=True)
    longest = max(int(rows.max() - rows.min()), int(columns.max() - columns.min())) + 1
    assert longest / alpha.shape[0] == pytest.approx(FOREGROUND_RATIO, abs=0.03)
