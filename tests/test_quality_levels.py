"""What was measured, in the shares that the panel speaks in."""

import pytest

from arm_blender.quality_levels import MeasuredLevel


def test_errors_are_shares_of_the_longest_side_and_of_the_range_of_colours():
    level = MeasuredLevel({}, chamfer=0.04, psnr=20.0)  # Of a longest side of 2, both ways together; dB.
    assert level.off_in_shape == pytest.approx(0.01)
    assert level.off_in_color == pytest.approx(0.1)
