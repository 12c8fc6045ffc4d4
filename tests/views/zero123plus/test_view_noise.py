"""Six views, six seeds: one is drawn anew without touching the noise of the others."""

import pytest
import torch

from arm_blender.views.zero123plus.view_noise import ViewNoise, picture_of_tiles, tiles


def test_the_views_lie_row_by_row():
    picture = torch.zeros(1, 1, 6, 4)
    for index in range(6):
        row, column = divmod(index, 2)
        picture[..., 2 * row : 2 * row + 2, 2 * column : 2 * column + 2] = index
    views = tiles(picture)
    assert views.shape == (6, 1, 2, 2) and views.amax(dim=(1, 2, 3)).tolist() == [0, 1, 2, 3, 4, 5]
    assert torch.equal(views.amin(dim=(1, 2, 3)), views.amax(dim=(1, 2, 3)))
    noise = torch.rand(1, 3, 12, 8)
    assert torch.equal(picture_of_tiles(tiles(noise)), noise)


@pytest.mark.parametrize("view", range(6))
def test_another_seed_changes_its_own_view_only(view):
    seeds = [7] * 6
    before = ViewNoise(seeds)
    seeds[view] = 8
    after = ViewNoise(seeds)
    for _ in range(3):  # Also in the later draws: each step takes one.
        changed = (tiles(before.views(4, 5)) != tiles(after.views(4, 5))).flatten(1)
        assert changed.any(dim=1).tolist() == [index == view for index in range(6)]
        assert torch.equal(before.reference(1, 4, 3, 3), after.reference(1, 4, 3, 3))


def test_views_of_one_seed_have_noise_of_unit_variance_and_nothing_in_common():
    noise = tiles(ViewNoise([3] * 6).views(4, 40)).flatten(1)
    assert float(noise.mean()) == pytest.approx(0.0, abs=0.02) and float(noise.std()) == pytest.approx(1.0, abs=0.02)
    assert float((torch.corrcoef(noise) - torch.eye(6)).abs().max()) < 0.05
