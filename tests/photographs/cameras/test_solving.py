"""Photographs of made-up things, solved for real: right cameras, or a line that says what is wrong."""

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.errors import ArmError, CameraError, InputImageError
from arm_blender.graphics.similarity import similarity
from arm_blender.photographs.cameras import working_copies
from arm_blender.photographs.cameras.solving import SolvingOptions, solved
from arm_blender.progress import silent

from .scenes import StillLife, capture, ring

OPTIONS = SolvingOptions(threads=2)


@pytest.fixture(autouse=True)
def known_masks(monkeypatch):
    """Finding masks is another room's matter: here they lie beside the pictures."""

    def mask(pixels, path, heard):
        found = path.parent.parent / "masks" / f"{path.stem}.png"
        return torch.from_numpy(np.asarray(Image.open(found)) / 255.0).float() if found.exists() else None

    monkeypatch.setattr(working_copies, "_mask", mask)


def pictures_of(folder):
    return sorted(folder.iterdir())


@pytest.mark.long
def test_cameras_are_found_to_a_hundredth_of_their_distance(tmp_path):
    truth = ring(10)
    folder = capture(tmp_path / "capture", StillLife(), truth)
    (folder / "IMG_0010.jpg").write_bytes((folder / "IMG_0001.jpg").read_bytes()[:300])  # Torn off.
    (tmp_path / "out").mkdir()
    found = solved(pictures_of(folder), folder, tmp_path / "out", OPTIONS, silent)
    assert found.trust.level == "good" and found.facts["solved"] == 10
    assert list(found.capture.left_out) == ["IMG_0010.jpg"]
    posed = found.capture.photographs
    expected = torch.from_numpy(truth)[[int(photograph.path.stem[-4:]) for photograph in posed]]
    centers = torch.stack([photograph.c2w[:3, 3] for photograph in posed])
    scale, rotation, shift = similarity(centers, expected[:, :3, 3])
    off = (scale * centers @ rotation.T + shift - expected[:, :3, 3]).norm(dim=1)
    assert float(off.max()) < 0.01 * 4.0
    up = rotation @ torch.tensor([0.0, 0.0, 1.0]).double()
    assert float(up[2]) > 0.999 and found.facts["up"] == "the ground's plane"
    # The ground of the capture is z = 0 of the truth; the object's middle is in the middle of the box.
    ground = (torch.tensor([0.0, 0.0, 0.0]).double() - shift) @ rotation / scale
    assert float(ground[2]) == pytest.approx(-0.7 / scale, abs=0.1)
    assert all(photograph.mask is not None and photograph.mask.is_file() for photograph in posed)


@pytest.mark.long
def test_pictures_of_two_things_are_refused(tmp_path):
    scenes = [StillLife(seed=0 if index < 7 else 500, tiles=0) for index in range(14)]
    folder = capture(tmp_path / "capture", scenes, ring(14))
    (tmp_path / "out").mkdir()
    with pytest.raises(CameraError, match="of one object"):
        solved(pictures_of(folder), folder, tmp_path / "out", OPTIONS, silent)


@pytest.mark.parametrize("count", [2, 4])
def test_too_few_pictures_are_refused_at_once(tmp_path, count):
    folder = capture(tmp_path / "capture", StillLife(), ring(count), size=(64, 48))
    with pytest.raises(InputImageError, match=f"images: {count} pictures .*; give 20 pictures or more"):
        solved(pictures_of(folder), folder, tmp_path, OPTIONS, silent)


def test_pictures_that_cannot_be_read_are_named(tmp_path):
    for index in range(6):
        (tmp_path / f"{index}.jpg").write_bytes(b"no picture")
    with pytest.raises(InputImageError, match="0 of 6 pictures do .0.jpg: not a readable picture"):
        solved(pictures_of(tmp_path), tmp_path, tmp_path, OPTIONS, silent)


@pytest.mark.long
def test_blank_pictures_are_refused(tmp_path):
    for index in range(6):
        Image.new("RGB", (320, 240), (120, 120, 120)).save(tmp_path / f"{index}.jpg")
    with pytest.raises(ArmError, match="are they sharp, and of one object"):
        solved(pictures_of(tmp_path), tmp_path, tmp_path, OPTIONS, silent)
