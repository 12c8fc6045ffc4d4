"""What is doubtful about a mask."""

import torch

from arm_blender.views.masks import doubt, shreds


def disc(size: int = 96, radius: float = 20.0, x: float = 48.0) -> torch.Tensor:
    """A soft-edged disc."""
    rows, columns = torch.meshgrid(torch.arange(size) + 0.5, torch.arange(size) + 0.5, indexing="ij")
    return (radius - ((rows - 48.0) ** 2 + (columns - x) ** 2).sqrt() + 0.5).clamp(0.0, 1.0)


def test_a_whole_object_is_not_doubted_nor_one_that_the_border_cuts():
    assert doubt(disc()) is None
    assert doubt(disc(x=5.0)) is None


def test_what_is_neither_object_nor_background_is_doubted():
    assert "not certain" in doubt(torch.maximum(disc(), 0.6 * disc(radius=30.0)))


def test_a_pattern_all_over_is_shreds_but_not_a_few_parts_nor_one_with_specks():
    leaves = torch.zeros(96, 96)
    for row in range(4, 80, 14):
        for column in range(4, 80, 14):
            leaves[row : row + 10, column : column + 10] = 1.0
    assert shreds(leaves) == "it is in 36 pieces over 39% of the picture"
    assert shreds(torch.maximum(disc(x=24.0), disc(x=72.0))) is None
    specks = disc()
    specks[::7, :20:7] = 1.0
    assert shreds(specks) is None and shreds(torch.zeros(9, 9)) is None


def test_what_reaches_along_the_border_is_doubted():
    ground = torch.zeros(96, 96)
    ground[40:] = 1.0
    assert "border" in doubt(ground)


def test_two_objects_are_doubted_but_not_one_with_a_small_part():
    assert "several parts" in doubt(torch.maximum(disc(x=24.0), disc(x=72.0)))
    assert doubt(torch.maximum(disc(x=30.0), disc(radius=6.0, x=72.0))) is None
