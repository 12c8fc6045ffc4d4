"""Small copies of photographs: a mask that lies beside one is taken, and is no photograph itself."""

import numpy as np
import pytest
from PIL import Image

from arm_blender.photographs.cameras.working_copies import working_copies
from arm_blender.photographs.pictures import photographs_in
from arm_blender.progress import silent


@pytest.fixture
def folder(tmp_path):
    own = tmp_path / "shoe"
    own.mkdir()
    rng = np.random.default_rng(0)
    for k in range(3):
        Image.fromarray(rng.integers(0, 255, (150, 200, 3), np.uint8)).save(own / f"IMG_{k}.jpg")
    mask = np.zeros((150, 200), np.uint8)
    mask[40:110, 60:130] = 255
    (own / "masks").mkdir()
    Image.fromarray(mask).save(own / "masks" / "IMG_0.png")
    Image.fromarray(mask.T.copy().T[:, ::-1].copy()).save(own / "IMG_1.mask.png")
    Image.fromarray(mask[:, :150]).save(own / "masks" / "IMG_2.png")  # Of another shape.
    return own


def test_masks_beside_photographs_are_theirs(folder, tmp_path):
    paths = photographs_in(folder)
    assert [path.name for path in paths] == ["IMG_0.jpg", "IMG_1.jpg", "IMG_2.jpg"]
    grey, colors = tmp_path / "grey", tmp_path / "colors"
    grey.mkdir()
    colors.mkdir()
    copies, left_out = working_copies(paths, grey, colors, silent)
    assert [copy.told for copy in copies] == [("mask file",), ("mask file",)]
    assert not any(copy.is_guessed for copy in copies)
    assert int((copies[0].mask > 0.5).sum()) == 70 * 70 and bool(copies[1].mask[60, 80] > 0.5)
    assert list(left_out) == ["IMG_2.jpg"] and "IMG_2.png" in left_out["IMG_2.jpg"]
    assert sorted(path.name for path in colors.iterdir()) == [copy.name for copy in copies] + ["0002.png"]
