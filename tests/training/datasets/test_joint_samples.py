"""What the joint look learns from: windows of whole captures, by cameras that are a little wrong."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.errors import ArmError
from arm_blender.photographs.masks.evidence import CHANNELS
from training.datasets import joint_samples
from training.datasets.joint_samples import GROUND, drawn, mistaken, plain, read_capture

from ...photographs.masks.ball_on_ground import GROUND as HEIGHT_OF_GROUND
from ...photographs.masks.ball_on_ground import LENS, eyes, photograph


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("captures") / "ball-0"
    folder.mkdir()
    entries = []
    for k, eye in enumerate(eyes(6)):
        picture, ball, _ = photograph(eye)
        Image.fromarray((picture * 255).byte().permute(1, 2, 0).numpy()).save(folder / f"{k}.png")
        Image.fromarray((ball * 255).byte().numpy()).save(folder / f"mask-{k}.png")
        c2w = torch.linalg.inv(eye.w2c) @ torch.diag(eye.w2c.new_tensor([1.0, -1.0, -1.0, 1.0]))
        lens = {"model": LENS.model, "parameters": LENS.parameters, "width": LENS.width, "height": LENS.height}
        entries.append({"file": f"{k}.png", "mask": f"mask-{k}.png", "c2w": c2w.tolist(), "lens": lens})
    np.savez(folder / "mesh.npz", vertices=np.array([[0.0, 0.0, HEIGHT_OF_GROUND], [0.0, 0.0, 1.0]]))
    (folder / "truth.json").write_text(json.dumps({"object": "ball", "pictures": entries}))
    return folder


@pytest.fixture(scope="module")
def samples(capture):
    return read_capture(capture, 64, 0)


def test_a_window_shows_the_object_its_mask_and_its_evidence(samples):
    count = 6 * joint_samples.VARIANTS
    assert samples.rgb.shape == (count, 3, 64, 64) and samples.evidence.shape == (count, CHANNELS, 64, 64)
    assert samples.mask.shape == (count, 1, 64, 64) and samples.name == "ball"
    red = samples.rgb[:, :1].float() - samples.rgb[:, 1:2].float() > 40.0
    mask = samples.mask > 127
    assert float((red & mask).sum() / mask.sum()) > 0.9 and float((red & ~mask).sum() / mask.sum()) < 0.1


def test_two_variants_are_not_alike(samples):
    assert not torch.equal(samples.mask[:6], samples.mask[6:])


def test_one_sample_in_some_knows_no_ground(samples):
    inputs, alpha = drawn([samples], 40, torch.Generator().manual_seed(0))
    assert inputs.shape == (40, 3 + CHANNELS, 64, 64) and alpha.shape == (40, 1, 64, 64)
    without = (inputs[:, 3:][:, GROUND].flatten(1) == 0.0).all(dim=1)
    assert 0 < int(without.sum()) < 20
    assert len(plain([samples])[0]) == 4


def test_mistaken_cameras_are_a_little_wrong(capture):
    truth = json.loads((capture / "truth.json").read_text())
    poses = [(torch.tensor(entry["c2w"], dtype=torch.float64), entry["lens"]) for entry in truth["pictures"]]
    found, ground = mistaken(poses, -1.0, torch.Generator().manual_seed(3))
    centers = torch.stack([eye.center for eye in found])
    true = torch.stack([c2w[:3, 3] for c2w, _ in poses])
    sides = torch.cdist(centers, centers) / torch.cdist(true, true).clamp(min=1e-9)
    ratio = sides[~torch.eye(6, dtype=torch.bool)]
    assert 1e-4 < float(ratio.std() / ratio.mean()) < 0.02 and 0.7 < float(ratio.mean()) < 1.4
    assert abs(ground / float(ratio.mean()) + 1.0) < 0.25


def test_a_capture_that_is_not_whole_is_named(capture, tmp_path):
    (tmp_path / "truth.json").write_text((capture / "truth.json").read_text())
    with pytest.raises(ArmError, match="not a whole capture"):
        read_capture(tmp_path, 64, 0)
