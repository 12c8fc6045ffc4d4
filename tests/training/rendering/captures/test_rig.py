"""Where the simulated hand goes: around, above the ground, or as a spoilt capture has it."""

import math

import numpy as np
import pytest
import torch

from training.rendering.captures.rig import FEW, CaptureConfig, hand_held, phone_lens


def azimuths_deg(poses) -> torch.Tensor:
    eyes = torch.stack([pose.around_object()[:3, 3] for pose in poses])
    return torch.rad2deg(torch.atan2(eyes[:, 0], -eyes[:, 1])) % 360.0


def widest_gap(poses) -> float:
    found = azimuths_deg(poses).sort().values
    return float(torch.cat([found[1:] - found[:-1], found[:1] + 360.0 - found[-1:]]).max())


@pytest.mark.parametrize("pictures", [12, 24, 40])
def test_a_walk_goes_all_around_and_looks_at_the_object(pictures):
    poses = hand_held(CaptureConfig(pictures=pictures), 1.2, np.random.default_rng(0))
    assert len(poses) == pictures and widest_gap(poses) < 70.0
    for pose in poses:
        c2w = pose.around_object()
        assert torch.allclose(c2w[:3, :3] @ c2w[:3, :3].T, torch.eye(3, dtype=torch.float64), atol=1e-6)
        forward, to_object = -c2w[:3, 2], -c2w[:3, 3] / c2w[:3, 3].norm()
        assert float(forward @ to_object) > math.cos(math.radians(8.0))
        assert float(c2w[2, 3]) > 0.0


def test_few_pictures_come_from_one_side():
    poses = hand_held(CaptureConfig(spoilt="few"), 1.2, np.random.default_rng(0))
    assert len(poses) == FEW and widest_gap(poses) > 250.0


def test_a_turned_object_is_seen_from_all_around_by_a_camera_that_stays():
    poses = hand_held(CaptureConfig(spoilt="turned"), 1.2, np.random.default_rng(0))
    eyes = torch.stack([pose.c2w[:3, 3] for pose in poses])
    assert widest_gap(poses) < 40.0
    assert float((eyes / eyes.norm(dim=1, keepdim=True)).std(dim=0).max()) < 0.1


@pytest.mark.parametrize("seed", range(5))
def test_the_lens_is_a_phones(seed):
    lens = phone_lens(CaptureConfig(k1=-0.04), np.random.default_rng(seed))
    assert (lens.model, lens.width, lens.height, lens.parameters[3]) == ("SIMPLE_RADIAL", 800, 600, -0.04)
    assert 65.0 <= 2.0 * math.degrees(math.atan(400.0 / lens.parameters[0])) <= 75.0
