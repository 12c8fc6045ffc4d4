"""The paper's views lie where the paper's predecessor draws them, and all of them see the object."""

import math

import numpy as np
import pytest
import torch

from arm_blender.graphics.cameras import project
from arm_blender.views.rigs import zero123plus_rig
from training.rendering.camera_rigs import FOVY_DEG, paper_rig, random_views, varied_rig


def test_the_papers_rig_is_six_inputs_and_random_views_in_their_ranges():
    cameras = paper_rig(np.random.default_rng(0), 64, views=400)
    assert len(cameras) == 406
    for ours, theirs in zip(cameras, zero123plus_rig(distance=6.0, size=64), strict=False):
        assert torch.equal(ours.c2w, theirs.c2w) and torch.equal(ours.K, theirs.K)
    eyes = torch.stack([camera.center for camera in cameras[6:]])
    distance, azimuth = eyes.norm(dim=1), torch.atan2(eyes[:, 1], eyes[:, 0])
    for values, (low, high) in ((distance, (2.0, 3.5)), (eyes[:, 2], (-0.75, 1.6)), (azimuth, (-math.pi, math.pi))):
        margin = 0.02 * (high - low)
        assert low - 1e-4 <= float(values.min()) < low + margin and high - margin < float(values.max()) <= high + 1e-4
    assert all(math.degrees(camera.fovy) == pytest.approx(FOVY_DEG) for camera in cameras[6:])


@pytest.mark.parametrize(
    "cameras",
    [
        paper_rig(np.random.default_rng(1), 32),
        varied_rig(np.random.default_rng(1), 32),
        random_views(32, torch.Generator().manual_seed(1)),
    ],
    ids=["paper", "varied", "rasterised"],
)
def test_every_view_has_the_origin_in_its_middle_and_the_ball_of_radius_one_in_front(cameras):
    for camera in cameras:
        pixel, depth = project(torch.zeros(3), camera)
        assert torch.allclose(pixel, torch.tensor([16.0, 16.0]), atol=1e-3) and float(depth) > 1.0


def test_a_rig_follows_from_its_seed():
    first, again, other = (paper_rig(np.random.default_rng(seed), 32, views=3) for seed in (5, 5, 6))
    assert all(torch.equal(a.c2w, b.c2w) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first[6].c2w, other[6].c2w)
