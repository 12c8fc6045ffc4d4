"""The rig is the published one, seen in Blender's frame."""

import math

import pytest
import torch

from arm_blender.graphics.cameras import project
from arm_blender.views.rigs import front_camera, zero123plus_rig


def test_the_rig_is_the_published_one_turned_to_the_front():
    """Zero123++ v1.2's first camera to world matrix, whose input view looks from +X; ours looks from -Y."""
    published = torch.tensor(
        [[-0.5, -0.2962, 0.8138, 3.2552], [0.8660, -0.1710, 0.4698, 1.8794], [0.0, 0.9397, 0.3420, 1.3681]]
    )
    quarter = torch.tensor([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # -90 degrees about Z
    camera = zero123plus_rig(distance=4.0)[0]
    torch.testing.assert_close(camera.c2w[:3], quarter @ published, atol=2e-4, rtol=0)
    assert float(camera.K[0, 0] / camera.width) == pytest.approx(1.8660, abs=1e-4)


def test_the_rig_looks_at_the_origin_from_all_around():
    rig = zero123plus_rig(distance=6.0, fovy_deg=40.0, size=128)
    for camera in rig:
        pixel, depth = project(torch.zeros(3), camera)
        torch.testing.assert_close(pixel, torch.tensor([64.0, 64.0]))
        assert float(depth) == pytest.approx(6.0)
        assert camera.fovy == pytest.approx(math.radians(40.0))
    heights = [float(camera.center[2]) / 6.0 for camera in rig]
    assert heights == pytest.approx([math.sin(math.radians(e)) for e in (20, -10, 20, -10, 20, -10)])


@pytest.mark.parametrize(("longest", "size", "fovy_deg"), [(272.0, 320, 30.0), (85.0, 100, 50.0)])
def test_the_front_camera_puts_the_longest_side_at_two(longest, size, fovy_deg):
    """A bar of length 2 through the origin, across the view, is as long in the picture as the object was."""
    camera = front_camera(longest, size, elevation_deg=0.0, fovy_deg=fovy_deg)
    assert float(camera.center[0]) == pytest.approx(0.0) and float(camera.center[1]) < 0.0
    pixels, _ = project(torch.tensor([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), camera)
    assert float(pixels[1, 0] - pixels[0, 0]) == pytest.approx(longest, rel=1e-5)
