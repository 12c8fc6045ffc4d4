"""Views that are rasterised on the fly are what Cycles renders, visibility included."""

from dataclasses import replace

import pytest
import torch

from arm_blender.graphics.cameras import orbit_camera

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def command():
    return pytest.importorskip("training.studies.rasterized_blender")


def test_a_lit_view_is_close_to_cycles_and_closer_with_shadows(command, tmp_path):
    """A ring of many materials under a low sun and a dim sky: half of its inside lies in its own shadow."""
    generator = torch.Generator().manual_seed(3)
    scene = command.scene_of(next(command.shapes(None, 1, generator))[1], command.rasterized.Library([], []), generator)
    sun = command.Sun(torch.tensor([-0.8, 0.0, 0.6]), torch.tensor([3.0, 2.8, 2.5]), 0.02)
    scene = replace(scene, radiance=torch.full_like(scene.radiance, 0.15), suns=(sun,))
    camera = orbit_camera(0.0, 45.0, 5.0, 30.0, 48, 48)
    (truth,) = command.by_cycles(scene, (camera,), 32, tmp_path)
    (found,), (bare,) = (command.ours(scene, (camera,), shadows) for shadows in (True, False))
    (ours, unshadowed, brightness), _ = command.compared(truth, found, bare)
    assert ours > 22.0 and ours > unshadowed + 3.0
    assert brightness == pytest.approx(1.0, abs=0.1)
    # One camera, one mesh: the outlines are the same.
    assert (truth[3] - found[3]).abs().mean() < 0.01


def test_a_lamp_is_turned_towards_its_direction(command):
    for direction in torch.nn.functional.normalize(torch.randn(20, 3, generator=torch.Generator().manual_seed(0))):
        w, x, y, z = command.rotation_to(direction)
        # The third column of the rotation: where +Z goes.
        turned = torch.tensor([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        torch.testing.assert_close(turned, direction, atol=1e-5, rtol=0.0)
