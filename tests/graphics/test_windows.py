"""The largest and the smallest value in a square around each pixel."""

import torch

from arm_blender.graphics.windows import highest_around, lowest_around


def test_a_point_becomes_a_square():
    image = torch.zeros(9, 9)
    image[4, 3] = 1.0
    expected = torch.zeros(9, 9)
    expected[2:7, 1:6] = 1.0
    assert torch.equal(highest_around(image, 2), expected)


def test_the_border_is_no_value():
    image = torch.full((4, 5), -2.0)
    assert torch.equal(highest_around(image, 3), image)
    assert torch.equal(lowest_around(-image, 3), -image)


def test_the_lowest_is_what_all_around_reaches():
    image = torch.rand(7, 6, generator=torch.Generator().manual_seed(0))
    found = lowest_around(image, 1)
    assert float(found[3, 2]) == float(image[2:5, 1:4].min())
    assert float(found[0, 0]) == float(image[:2, :2].min())
