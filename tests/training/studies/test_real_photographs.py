"""Published projections become poses, and what a real capture's asset reaches is told beside them."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import orbit_camera
from training.__main__ import main
from training.evaluation.tables.contact_sheet import TILE
from training.evaluation.trials.capture_trial import Answer
from training.studies import real_photographs
from training.studies.real_photographs import pose_of, published


def projection(camera) -> np.ndarray:
    """Of a camera, times a factor that says nothing."""
    w2c = torch.linalg.inv(camera.c2w.double()) if camera.c2w.dtype != torch.float64 else torch.linalg.inv(camera.c2w)
    w2c = torch.diag(w2c.new_tensor([1.0, -1.0, -1.0, 1.0])) @ w2c
    return -2.5 * (camera.K.double() @ w2c[:3]).numpy()


@pytest.fixture
def cameras():
    return {f"{k:05d}": orbit_camera(40.0 * k, 10.0 + 5.0 * k, 3.0, 40.0, 320, 240) for k in range(6)}


def test_a_projection_is_taken_apart(cameras):
    for camera in cameras.values():
        np.testing.assert_allclose(pose_of(projection(camera)), camera.c2w.double().numpy(), atol=1e-5)


def test_no_projection_is_named(tmp_path):
    with pytest.raises(ArmError, match="no NAME_P.txt"):
        published(tmp_path)
    (tmp_path / "a_P.txt").write_text("1 2 3")
    with pytest.raises(ArmError, match="a_P.txt: no 3 x 4 projection"):
        published(tmp_path)


def test_what_was_found_is_told_and_shown(tmp_path, cameras, monkeypatch, capsys):
    photographs, asset = tmp_path / "photographs", tmp_path / "asset"
    (asset / "views").mkdir(parents=True)
    photographs.mkdir()
    frames = []
    for name, camera in cameras.items():
        np.savetxt(photographs / f"{name}_P.txt", projection(camera))
        Image.new("RGB", (32, 24), (200, 100, 50)).save(photographs / f"{name}.jpg")
        Image.new("RGBA", (16, 16), (200, 100, 50, 255)).save(asset / "views" / f"{name}.png")
        frames.append({"file_path": f"{name}.png", "photograph": f"{name}.jpg"})
    (asset / "views" / "transforms.json").write_text(json.dumps({"frames": frames}))
    (asset / "report.json").write_text(json.dumps({"photographs": {"pictures": 7}, "seen_share": 0.75}))
    Image.new("RGB", (64, 32)).save(asset / "preview.png")
    solved = {name: 2.0 * camera.c2w.double().numpy() for name, camera in cameras.items()}
    for name in solved:  # Scaled and shifted, as solved ones are.
        solved[name][:3, :3] /= 2.0
        solved[name][:3, 3] += 1.0
    monkeypatch.setattr(real_photographs, "read_solved", lambda folder: solved)
    monkeypatch.setattr(real_photographs, "answer", lambda *args: Answer("solved", "", 12.0, 900.0))
    document = tmp_path / "page.md"
    document.write_text("<!-- real:begin -->\n<!-- real:end -->\n")
    words = ["--photographs", str(photographs), "--projections", str(photographs), "--output", str(asset)]
    words += ["--sheet", str(tmp_path / "sheet.jpg"), "--document", str(document)]
    assert main(["evaluate-photographs", *words]) == 0
    text = document.read_text()
    assert "| pictures with a camera | 6 of 7 |" in text and "median 0.00%, worst 0.00%" in text
    assert "| share of the surface that they see | 75% |" in text and text.startswith("<!-- real:begin -->")
    assert Image.open(tmp_path / "sheet.jpg").width == 5 * TILE
