"""Every solved camera is kept, exactly."""

from pathlib import Path

import numpy as np
import pytest
import torch

from arm_blender.errors import CameraError
from arm_blender.photographs.capture import Capture, Lens, PosedPhotograph
from arm_blender.photographs.solved import SOLVED, read_solved, write_solved


def test_cameras_come_back_exactly(tmp_path):
    c2w = torch.eye(4, dtype=torch.float64)
    c2w[0, 3] = 1.0 / 3.0
    lens = Lens("PINHOLE", (500.0, 500.0, 320.0, 240.0), 640, 480)
    posed = PosedPhotograph(Path("somewhere/IMG_1.HEIC"), c2w, lens)
    write_solved(Capture((posed,), torch.zeros(0, 3), {"IMG_2.HEIC": "blurred"}), tmp_path)
    assert np.array_equal(read_solved(tmp_path)["IMG_1"], c2w.numpy())


@pytest.mark.parametrize("text", [None, "{", "[]", '{"cameras": {"a": [1]}}'])
def test_a_damaged_record_is_one_line(tmp_path, text):
    if text is not None:
        (tmp_path / SOLVED).write_text(text)
    with pytest.raises(CameraError, match=r"solved\.json: no record of solved cameras .*; solve them again"):
        read_solved(tmp_path)


@pytest.mark.parametrize(("name", "varies"), [("IMG_1.HEIC", True), ("a.jpeg", True), ("render_0001.png", False)])
def test_only_what_cameras_write_may_be_exposed_each_by_itself(name, varies):
    lens = Lens("PINHOLE", (500.0, 500.0, 320.0, 240.0), 640, 480)
    posed = PosedPhotograph(Path(name), torch.eye(4, dtype=torch.float64), lens)
    assert Capture((posed,), torch.zeros(0, 3)).varying_exposure == varies
