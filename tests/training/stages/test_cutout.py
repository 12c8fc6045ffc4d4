"""The stage of the cut-out network: its loss in closed form, and a short fit that learns to tell red from blue."""

import numpy as np
import pytest
import torch

from arm_blender.models.small.cutout import Cutout, CutoutConfig
from arm_blender.weight_files import checkpoints
from training.__main__ import main
from training.stages import cutout as stage
from training.stages.cutout import cutout_loss, validate

pytestmark = pytest.mark.usefixtures("one_thread")


def test_the_loss_of_a_right_mask_is_nothing_and_of_a_wrong_one_much():
    alpha = torch.zeros(2, 1, 32, 32)
    alpha[:, :, 8:24, 8:24] = 1.0
    coarse = torch.nn.functional.avg_pool2d(alpha, 8)
    right, _ = cutout_loss(40.0 * (alpha - 0.5), 40.0 * (coarse - 0.5), alpha)
    wrong, numbers = cutout_loss(-40.0 * (alpha - 0.5), -40.0 * (coarse - 0.5), alpha)
    assert float(right) < 1e-4
    assert numbers["cross entropy"] == pytest.approx(20.0, rel=1e-3)
    assert numbers["missed"] == pytest.approx(1.0 - 20.0 / (32 * 32 + 20.0), rel=1e-3)
    assert float(wrong) == pytest.approx(sum(numbers.values()) + stage.COARSE_WEIGHT * 20.0, rel=1e-3)


def test_validation_is_the_intersection_over_union(monkeypatch):
    alpha = torch.zeros(3, 1, 32, 32)
    alpha[:, :, :16] = 1.0
    found = torch.full((3, 1, 32, 32), -5.0)
    found[0, :, :16], found[1, :, :8] = 5.0, 5.0
    network = torch.nn.Identity()
    monkeypatch.setattr(network, "forward", lambda srgb: found[: len(srgb)])
    numbers = validate(network, (torch.zeros(3, 3, 32, 32), alpha))
    assert numbers["IoU"] == pytest.approx((1.0 + 0.5 + 0.0) / 3.0)


@pytest.mark.slow
def test_a_short_fit_learns_to_tell_an_object_from_its_ground(tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "CutoutConfig", lambda: CutoutConfig((8, 8, 16, 16), (0, 1, 1, 1), 1, 2, 48))
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:48, :48] + 0.5
    (tmp_path / "scenes").mkdir()
    for k in range(20):
        mask = (rows - rng.uniform(16, 32)) ** 2 + (columns - rng.uniform(16, 32)) ** 2 < rng.uniform(8, 14) ** 2
        rgb = rng.integers(0, 90, (2, 48, 48, 3), np.uint8)
        rgb[0][mask] = rng.integers(150, 255, (int(mask.sum()), 3))
        masks = np.stack([mask, np.zeros_like(mask)]).astype(np.uint8) * 255
        np.savez_compressed(tmp_path / "scenes" / f"thing_{k}.npz", rgb=rgb, mask=masks)
    output = tmp_path / "cutout.safetensors"
    words = ["--steps", "60", "--batch", "6", "--size", "48", "--learning-rate", "5e-3", "--average", "0.9"]
    assert main(["fit", "cutout", "--scenes", str(tmp_path / "scenes"), "--output", str(output), *words]) == 0
    config, state = checkpoints.load(output, CutoutConfig)
    network = Cutout(config).eval()
    checkpoints.restore(network, state, output)
    scenes = stage.read_scenes(tmp_path / "scenes")
    assert validate(network, stage.plain(scenes, 48))["IoU"] > 0.7
