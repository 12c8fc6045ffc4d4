"""The sheet of views, asset and difference."""

import torch

from arm_blender.light_check.comparison import BACKDROP, GLOW, comparison

GREY = round(255 * BACKDROP)


def flat(value: float, alpha: float = 1.0, count: int = 1) -> torch.Tensor:
    """(count, 4, 2, 2) sRGB."""
    return torch.cat([torch.full((count, 3, 2, 2), value), torch.full((count, 1, 2, 2), alpha)], dim=1)


def test_a_row_is_the_picture_the_asset_and_how_far_they_differ():
    sheet = comparison(flat(0.8), flat(0.6))
    assert sheet.shape == (3, 2, 6)
    assert sheet[0, 0].tolist() == [204, 204, 153, 153, *[round(255 * 0.2 * GLOW)] * 2]


def test_where_one_of_both_is_not_there_nothing_glows():
    for pictures, drawn in ((flat(1.0, 0.0), flat(0.5)), (flat(1.0), flat(0.5, 0.0))):
        assert int(comparison(pictures, drawn)[:, :, 4:].max()) == 0
    assert comparison(flat(1.0, 0.0), flat(0.5))[0, 0, 0] == GREY


def test_more_than_eight_views_stand_in_two_blocks():
    pictures = flat(0.0, count=9)
    pictures[8, :3] = 1.0
    sheet = comparison(pictures, flat(0.0, count=9))
    assert sheet.shape == (3, 16, 12)
    assert sheet[0, :2, 6:8].unique().tolist() == [255] and sheet[0, 2:, 6:].unique().tolist() == [GREY]
