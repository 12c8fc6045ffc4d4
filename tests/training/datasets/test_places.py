"""Places without an object: a view shows what lies in its direction, and only what training may see."""

import json

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from PIL import Image

from arm_blender.errors import ArmError
from arm_blender.graphics.color import linear_from_srgb
from training.datasets.places import SIDE, VIEWS, read_places


@pytest.fixture
def data(tmp_path):
    """An environment of a blue sky above a red ground, one texture of each split."""
    pixels = np.zeros((32, 64, 3), np.float32)
    pixels[:16], pixels[16:] = (0.1, 0.2, 0.9), (0.8, 0.1, 0.1)
    output = oiio.ImageOutput.create(str(tmp_path / "sky.hdr"))
    output.open(str(tmp_path / "sky.hdr"), oiio.ImageSpec(64, 32, 3, "float"))
    output.write_image(pixels)
    output.close()
    for split, color in (("train", (0, 255, 0)), ("eval", (255, 255, 255))):
        Image.new("RGB", (64, 64), color).save(tmp_path / f"{split}.png")
    textures = [{"id": s, "split": s, "maps": {"basecolor": f"{s}.png"}} for s in ("train", "eval")]
    hdris = [{"id": "sky", "split": "train", "files": ["sky.hdr"]}, {"id": "no", "split": "eval", "files": ["no.hdr"]}]
    (tmp_path / "manifest.json").write_text(json.dumps({"objects": [], "textures": textures, "hdris": hdris}))
    return tmp_path


def test_the_sky_is_above_the_ground_and_a_texture_is_itself(data):
    *views, texture = read_places(data, 0)
    assert len(views) == VIEWS and all(view.shape == (3, SIDE, SIDE) and view.dtype == torch.uint8 for view in views)
    assert torch.equal(texture.amax(dim=(1, 2)), torch.tensor([0, 255, 0], dtype=torch.uint8))
    mixed = 0
    for view in views:
        linear = linear_from_srgb(view.float() / 255.0)
        sky = (linear[2] > linear[0]).float()
        assert bool((sky[:-1] >= sky[1:] - 1e-6).all())  # From some row on there is ground, in every column.
        mixed += 0.0 < float(sky.mean()) < 1.0
    assert mixed > VIEWS // 3


def test_the_same_seed_looks_at_the_same_places(data):
    first, again, other = (read_places(data, seed) for seed in (1, 1, 2))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(first, other, strict=True))


def test_a_missing_environment_is_named(data):
    (data / "sky.hdr").unlink()
    with pytest.raises(ArmError, match=r"sky\.hdr"):
        read_places(data, 0)
