"""The table of masks: what a way finds is compared with the truth of the capture, in closed form."""

import json
import math

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.graphics.cameras import orbit_camera
from arm_blender.views.masks import Unsure
from training.__main__ import main
from training.studies import captured_masks
from training.studies.captured_masks import pictures, score, together


@pytest.fixture
def captures(tmp_path):
    """One capture of three pictures: a square of 40 x 40 pixels that moves to the right."""
    folder = tmp_path / "captures" / "square-0"
    (folder / "images").mkdir(parents=True)
    (folder / "masks").mkdir()
    told = []
    for k in range(3):
        mask = np.zeros((80, 120), np.uint8)
        mask[20:60, 20 + 10 * k : 60 + 10 * k] = 255
        Image.fromarray(mask).convert("RGB").save(folder / "images" / f"{k}.jpg")
        Image.fromarray(mask).save(folder / "masks" / f"{k}.png")
        told.append({"file": f"images/{k}.jpg", "mask": f"masks/{k}.png"})
    (folder / "truth.json").write_text(json.dumps({"pictures": told}))
    return tmp_path / "captures"


def test_a_score_is_the_intersection_over_union(captures):
    _, image, truth = next(pictures(captures / "square-0"))
    half = truth.float()
    half[40:] = 0.0
    assert score(lambda image, truth: truth.float(), image, truth)[0].iou == 1.0
    assert score(lambda image, truth: half, image, truth)[0].iou == 0.5

    def unsure(image, truth):
        raise Unsure("it is foggy")

    nothing, mask = score(unsure, image, truth)
    assert nothing.iou == 0.0 and nothing.doubted and not mask.any()


def test_the_table_and_the_sheets_are_made_of_what_the_ways_find(captures, tmp_path, monkeypatch, capsys):
    ways = {
        "small network": lambda image, truth: (image[0] > 0.5).float(),
        "left half": lambda image, truth: truth * (torch.arange(120) < 60).float(),
    }
    monkeypatch.setattr(captured_masks, "known_ways", lambda: ways)
    document = tmp_path / "photographs.md"
    document.write_text("before\n<!-- masks:begin -->\n<!-- masks:end -->\nafter\n")
    words = ["--captures", str(captures), "--sheets", str(tmp_path / "sheets"), "--document", str(document)]
    assert main(["evaluate-masks", *words]) == 0
    said = capsys.readouterr().out
    assert document.read_text().startswith("before") and "| square-0 | left half | 3 | 0.750 |" in document.read_text()
    assert "| square-0 | small network | 3 |" in said
    assert (tmp_path / "sheets" / "square-0.png").is_file()


def test_a_folder_without_captures_is_refused(tmp_path, capsys):
    assert main(["evaluate-masks", "--captures", str(tmp_path)]) == 1
    assert "layout capture" in capsys.readouterr().err


def test_grabcut_finds_a_square_in_its_box(captures):
    pytest.importorskip("cv2")
    _, image, truth = next(pictures(captures / "square-0"))
    assert score(captured_masks.by_grabcut, image, truth)[0].iou > 0.9


def test_masks_of_a_capture_are_compared_by_its_cameras(tmp_path, monkeypatch):
    """A ball seen from twelve sides; to one mask something was added, which the eleven others take away."""
    folder, side = tmp_path / "ball-0", 96
    (folder / "images").mkdir(parents=True)
    (folder / "masks").mkdir()
    rows, columns = np.mgrid[:72, :side] + 0.5
    radius = 120.0 * 0.5 / math.sqrt(4.0**2 - 0.5**2)  # Of the outline of a ball of radius 0.5, four units away.
    ball = (rows - 36.0) ** 2 + (columns - 48.0) ** 2 < radius**2
    told, alphas = [], []
    for k in range(12):
        camera = orbit_camera(30.0 * k, 15.0, 4.0, 30.0, side, 72)
        Image.fromarray(np.zeros((72, side, 3), np.uint8)).save(folder / "images" / f"{k}.jpg")
        Image.fromarray(ball.astype(np.uint8) * 255).save(folder / "masks" / f"{k}.png")
        lens = {"model": "SIMPLE_PINHOLE", "parameters": [120.0, 48.0, 36.0], "width": side, "height": 72}
        told.append({"file": f"images/{k}.jpg", "mask": f"masks/{k}.png", "c2w": camera.c2w.tolist(), "lens": lens})
        alphas.append(torch.from_numpy(ball).float())
    (folder / "truth.json").write_text(json.dumps({"pictures": told}))
    alphas[3][5:25, 5:25] = 1.0
    np.savez(folder / "mesh.npz", vertices=np.array([[0.0, 0.0, -0.5]]), faces=np.zeros((0, 3), np.int32))
    monkeypatch.setattr(captured_masks, "joint_masks", lambda picture, alphas, eyes, ground: alphas)
    found = together(folder, alphas)
    (same, kept), (scores, _) = found["all pictures together"], found["together and compared"]
    assert kept is alphas and same[3].iou < 0.8
    assert len(scores) == 12 and min(one.iou for one in scores) > 0.95 and not any(one.doubted for one in scores)
