"""Captures are judged by their cameras' centres, and a wrong solution that is passed off as right is counted."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from arm_blender.errors import ArmError
from arm_blender.graphics.cameras import orbit_camera
from training.evaluation.scores.geometry import GeometryScores
from training.evaluation.scores.image_scores import MISSED
from training.evaluation.tables.capture_table import save_overview, summary
from training.evaluation.tables.contact_sheet import CAPTION, TILE
from training.evaluation.trials.capture_trial import (
    DOUBTFUL,
    REFUSED,
    SOLVED,
    Answer,
    CaptureResult,
    camera_errors,
)
from training.evaluation.trials.measure import SystemResult
from training.evaluation.truth.captured import captured_objects

TRUE = {str(k): orbit_camera(40.0 * k, 10.0 + 5.0 * (k % 3), 4.0, 60.0, 64, 48).c2w.double().numpy() for k in range(9)}


def in_another_frame(poses):
    """The same cameras turned, moved, and at another scale, as a solver gives them."""
    cos, sin = np.cos(0.7), np.sin(0.7)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    moved = {}
    for name, c2w in poses.items():
        moved[name] = np.eye(4)
        moved[name][:3, :3] = turn @ c2w[:3, :3]
        moved[name][:3, 3] = 0.2 * turn @ c2w[:3, 3] + np.array([5.0, -1.0, 2.0])
    return moved


def test_another_frame_is_no_error_and_a_moved_camera_is():
    solved = in_another_frame(TRUE)
    found = camera_errors(solved, TRUE)
    assert max(found.centers.values()) < 1e-9 and max(found.angles.values()) < 1e-4
    point = found.motion @ np.append(solved["3"][:3, 3], 1.0)
    assert point[:3] == pytest.approx(TRUE["3"][:3, 3])
    solved["3"][:3, 3] += np.array([0.0, 0.0, 0.2 * 0.4])  # A tenth of its distance.
    off = camera_errors(solved, TRUE).centers
    assert max(off, key=off.__getitem__) == "3" and 0.05 < off["3"] < 0.15


def test_two_cameras_are_too_few_to_compare():
    with pytest.raises(ArmError, match="three are needed"):
        camera_errors({name: TRUE[name] for name in ("0", "1")}, TRUE)


def result(said: str, centers: list[float], spoilt: str | None = None) -> CaptureResult:
    answer = Answer(said, "the pictures do not agree", 100.0, 2000.0)
    errors = {str(index): error for index, error in enumerate(centers)}
    scores = SystemResult(GeometryScores(0.9, 0.6, 0.05, 15.0), maps={"albedo": replace(MISSED, psnr_in=20.0)})
    made = None if said == REFUSED else scores
    return CaptureResult("mug-0", spoilt, 10, answer, errors, made, made)


@pytest.mark.parametrize(
    ("said", "centers", "silent"),
    [
        (SOLVED, [0.001] * 10, False),
        (SOLVED, [0.001] * 9 + [0.2], True),
        (SOLVED, [0.03] * 10, True),
        (DOUBTFUL, [0.03] * 10, False),
        (REFUSED, [], False),
    ],
)
def test_only_a_wrong_solution_without_a_word_is_wrong_in_silence(said, centers, silent):
    assert result(said, centers).wrong_in_silence == silent


def test_the_table_counts_sound_captures_and_names_doubts():
    results = [result(SOLVED, [0.001] * 10), result(DOUBTFUL, [0.02] * 10), result(REFUSED, [], "blurred")]
    text = summary(results, "evaluate")
    assert "| captures with 90% right cameras or more | 1 of 2 |" in text
    assert "| wrong solutions passed off as right | 0 of 3 |" in text
    assert "doubtful: the pictures do not agree" in text and "2 captures and 1 that are spoilt" in text


def test_captures_are_read_as_they_are_rendered(tmp_path):
    folder = tmp_path / "mug-0"
    folder.mkdir()
    pictures = [{"file": f"images/{name}.jpg", "c2w": c2w.tolist()} for name, c2w in TRUE.items()]
    (folder / "truth.json").write_text(json.dumps({"object": "mug", "spoilt": None, "pictures": pictures}))
    (capture,) = captured_objects(tmp_path)
    assert (capture.name, capture.object, capture.spoilt) == ("mug-0", "mug", None)
    assert capture.poses["4"] == pytest.approx(TRUE["4"])
    (folder / "truth.json").write_text("{}")
    with pytest.raises(ArmError, match="render the capture again"):
        captured_objects(tmp_path)
    with pytest.raises(ArmError, match="no captures"):
        captured_objects(tmp_path / "elsewhere")


def test_the_overview_has_a_column_of_every_sheet(tmp_path):
    sheets = []
    for index, (color, rows) in enumerate({"red": 4, "lime": 1}.items()):  # A refused capture has photographs alone.
        sheets.append(tmp_path / f"{index}.jpg")
        Image.new("RGB", (4 * TILE, rows * (TILE + CAPTION)), color).save(sheets[-1], quality=95)
    save_overview(tmp_path / "overview.jpg", sheets)
    with Image.open(tmp_path / "overview.jpg") as image:
        low = image.height - 20
        shown = [image.getpixel(at) for at in ((40, 40), (40, low), (TILE // 2 + 40, 40), (TILE // 2 + 40, low))]
    for found, wanted in zip(shown, [(255, 0, 0), (255, 0, 0), (0, 255, 0), (255, 255, 255)], strict=True):
        assert max(abs(a - b) for a, b in zip(found, wanted, strict=True)) < 12
