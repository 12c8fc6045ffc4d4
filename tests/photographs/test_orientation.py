"""Turning a camera upright moves every pixel as turning the picture does."""

import numpy as np
import pytest
import torch

from arm_blender.errors import CameraError
from arm_blender.photographs.orientation import oriented

from .ball import LENSES, distorted, lens, orbit


@pytest.mark.parametrize("model", LENSES)
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_point_lands_where_its_pixel_was_turned_to(model, orientation):
    stored, c2w = lens(model), torch.tensor(orbit(3)[1])
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))
    turned, turned_c2w = oriented(stored, c2w, orientation, "cup.jpg")
    u, v = pixels(points, stored, c2w)
    width, height = stored.width, stored.height
    expected = {1: (u, v), 3: (width - u, height - v), 6: (height - v, u), 8: (v, width - u)}[orientation]
    np.testing.assert_allclose(pixels(points, turned, turned_c2w), expected, atol=1e-6)
    assert torch.det(turned_c2w[:3, :3]) == pytest.approx(1.0)


def pixels(points, one, c2w):
    local = (points - c2w[:3, 3].numpy()) @ c2w[:3, :3].numpy()
    return distorted(local[:, 0] / -local[:, 2], local[:, 1] / local[:, 2], one)


def test_a_mirrored_picture_is_refused_by_name():
    with pytest.raises(CameraError, match="cup.jpg"):
        oriented(lens("OPENCV"), torch.eye(4), 2, "cup.jpg")
