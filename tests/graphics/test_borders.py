"""A picture that cuts its object tells nothing of what is beyond; one that does not says that nothing is there."""

import math

import pytest
import torch

from arm_blender.graphics.borders import continued, cut_sides, scaled


def picture(*opaque: tuple[slice, slice]) -> torch.Tensor:
    """(4, 20, 30), its red growing to the right."""
    image = torch.zeros(4, 20, 30)
    image[0] = torch.arange(30) / 30.0
    for rows, columns in opaque:
        image[3, rows, columns] = 1.0
    return image


def test_what_is_whole_stays_as_it_is():
    whole = picture((slice(5, 15), slice(8, 20)))
    same, told = continued(whole, (2, 2, 28, 18))
    assert same is whole and told.tolist() == [-math.inf, -math.inf, math.inf, math.inf]


@pytest.mark.parametrize("side", range(4))
def test_an_object_goes_on_beyond_the_border_that_cuts_it(side):
    known = (6, 4, 24, 16)
    rows, columns = [
        (slice(8, 12), slice(6, 10)),
        (slice(4, 8), slice(10, 20)),
        (slice(8, 12), slice(18, 24)),
        (slice(12, 16), slice(10, 20)),
    ][side]
    image = picture((rows, columns))
    assert cut_sides(image[3], known) == tuple(index == side for index in range(4))
    found, told = continued(image, known)
    ends = [2 * 6 / 30 - 1, 2 * 4 / 20 - 1, 2 * 24 / 30 - 1, 2 * 16 / 20 - 1]
    assert told.tolist() == pytest.approx(
        [ends[i] if i == side else (-math.inf, -math.inf, math.inf, math.inf)[i] for i in range(4)]
    )
    beyond = [found[3, rows, :6], found[3, :4, columns], found[3, rows, 24:], found[3, 16:, columns]]
    assert [bool((part == 1.0).all()) for part in beyond] == [index == side for index in range(4)]
    if side == 0:
        assert bool((found[0, rows, :6] == image[0, rows, 6:7]).all()), "its colour goes on too"


def test_a_speck_at_the_border_cuts_nothing():
    assert cut_sides(picture((slice(5, 6), slice(0, 1)))[3], (0, 0, 30, 20)) == (False,) * 4


def test_a_scaled_rectangle_holds_whole_pixels_alone():
    assert scaled((3, 0, 30, 20), 0.5) == (2, 0, 15, 10)
    assert scaled((3, 5, 4, 6), 0.1) == (1, 1, 2, 2)
