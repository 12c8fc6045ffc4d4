"""Samples for the cut-out network: masks stay with their objects whatever is done to the picture."""

import numpy as np
import pytest
import torch

from arm_blender.errors import ArmError
from training.datasets import cutout_samples
from training.datasets.cutout_samples import drawn, plain, read_scenes


@pytest.fixture
def folder(tmp_path):
    """Four objects, red discs before a grain of blues."""
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:96, :96] + 0.5
    for k in range(4):
        masks = [(rows - 40 - 8 * n) ** 2 + (columns - 45) ** 2 < (18 + 4 * k) ** 2 for n in range(3)]
        masks.append(np.zeros((96, 96), bool))
        rgb = np.zeros((4, 96, 96, 3), np.uint8)
        rgb[..., 2] = rng.integers(120, 255, (4, 96, 96))
        for picture, mask in zip(rgb, masks, strict=True):
            picture[mask] = (230, 20, 20)
        np.savez_compressed(tmp_path / f"object_{k}.npz", rgb=rgb, mask=np.stack(masks).astype(np.uint8) * 255)
    return tmp_path


def test_the_mask_is_where_the_object_is_in_every_kind_of_sample(folder, monkeypatch):
    monkeypatch.setattr(cutout_samples, "developed", lambda srgb, random: srgb)  # Colours stay.
    random = torch.Generator().manual_seed(0)
    srgb, alpha = drawn(read_scenes(folder), 64, 80, random)
    assert srgb.shape == (80, 3, 64, 64) and alpha.shape == (80, 1, 64, 64)
    red, blue = srgb[:, :1] > 0.35, srgb[:, 2:] > 0.35
    certain = (alpha > 0.9) | (alpha < 0.1)
    agrees = torch.where(alpha > 0.5, red | (srgb[:, 2:] < 0.3), ~red | blue)[certain]
    assert float(agrees.float().mean()) > 0.98
    shares = (alpha > 0.5).flatten(1).float().mean(dim=1)
    assert float(shares.min()) == 0.0 and float(shares.max()) > 0.5  # Now and then nothing; often large.


def test_a_generator_gives_its_samples_again_and_another_one_others(folder):
    scenes = read_scenes(folder)
    first, again, other = (drawn(scenes, 32, 4, torch.Generator().manual_seed(seed))[0] for seed in (1, 1, 2))
    assert torch.equal(first, again) and not torch.equal(first, other)
    assert 0.0 <= float(first.min()) and float(first.max()) <= 1.0


def test_validation_sees_the_pictures_with_an_object_as_they_are(folder):
    scenes = read_scenes(folder)
    srgb, alpha = plain(scenes, 96)
    assert srgb.shape == (12, 3, 96, 96)
    assert torch.equal(alpha[0], scenes[0].mask[0] / 255.0) and bool((alpha.amax(dim=(1, 2, 3)) == 1.0).all())


def test_a_folder_without_scenes_and_a_damaged_file_are_refused(folder, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ArmError, match="layout scenes"):
        read_scenes(tmp_path / "empty")
    (folder / "object_1.npz").write_bytes(b"no archive")
    with pytest.raises(ArmError, match="object_1"):
        read_scenes(folder)
