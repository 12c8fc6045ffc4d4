"""Masks of one shape, some of them spoilt: what is spoilt is mended or dropped, and the rest stays to the bit."""

import math

import pytest
import torch

from arm_blender.errors import Cancelled
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.photographs.masks.agreement import agreed

SIDE = 160


@pytest.fixture(scope="module")
def cameras():
    low = [orbit_camera(30.0 * k, 12.0, 4.0, 45.0, SIDE, SIDE) for k in range(12)]
    return low + [orbit_camera(60.0 * k + 15.0, 45.0, 4.0, 45.0, SIDE, SIDE) for k in range(4)]


def balls(camera) -> torch.Tensor:
    """(1, S, S): a ball of radius 0.5 and one of 0.3 beside it, in closed form."""
    row, column = torch.meshgrid(torch.arange(SIDE) + 0.5, torch.arange(SIDE) + 0.5, indexing="ij")
    x, y = (column - camera.K[0, 2]) / camera.K[0, 0], (camera.K[1, 2] - row) / camera.K[1, 1]
    rays = torch.nn.functional.normalize(torch.stack([x, y, -torch.ones_like(x)], dim=-1), dim=-1)
    rays = rays @ camera.c2w[:3, :3].T
    hit = torch.zeros(SIDE, SIDE, dtype=torch.bool)
    for center, radius in (((0.0, 0.0, 0.0), 0.5), ((0.55, 0.1, 0.2), 0.3)):
        to = torch.tensor(center) - camera.center
        hit |= to.square().sum() - (rays @ to).square() < radius**2
    return hit[None].float()


@pytest.fixture
def masks(cameras) -> torch.Tensor:
    return torch.stack([balls(camera) for camera in cameras])


def iou(one: torch.Tensor, other: torch.Tensor) -> float:
    return float(((one > 0.5) & (other > 0.5)).sum() / ((one > 0.5) | (other > 0.5)).sum())


def test_masks_that_agree_stay_as_they_are(masks, cameras):
    found = agreed(masks, cameras)
    assert torch.equal(found.masks, masks) and found.words == {} and found.dropped == ()


def test_what_only_one_mask_shows_is_taken_away_with_a_word(masks, cameras):
    spoilt = masks.clone()
    spoilt[3, 0, 20:50, 15:40] = 1.0
    found = agreed(spoilt, cameras)
    assert set(found.words) == {3} and "taken away" in found.words[3] and found.dropped == ()
    assert iou(spoilt[3], masks[3]) < 0.9 and iou(found.masks[3], masks[3]) > 0.97
    others = [k for k in range(len(masks)) if k != 3]
    assert torch.equal(found.masks[others], masks[others])


def test_a_mask_that_lacks_half_of_the_object_is_dropped_and_carves_no_other(masks, cameras):
    spoilt = masks.clone()
    spoilt[5, 0, :, : SIDE // 2] = 0.0
    found = agreed(spoilt, cameras)
    assert found.dropped == (5,) and "lacks a part" in found.words[5] and set(found.words) == {5}


def test_however_much_clutter_a_mask_has_what_the_others_show_is_left(masks, cameras):
    spoilt = masks.clone()
    for k in (2, 7, 11):
        spoilt[k, 0, :60] = 1.0
    found = agreed(spoilt, cameras)
    assert set(found.words) == {2, 7, 11} and found.dropped == ()
    for k in (2, 7, 11):
        assert iou(spoilt[k], masks[k]) < 0.3 and iou(found.masks[k], masks[k]) > 0.9


def test_a_mask_of_something_else_is_dropped(masks, cameras):
    spoilt = masks.clone()
    spoilt[8] = masks[8].roll(70, dims=-1)
    found = agreed(spoilt, cameras)
    assert found.dropped == (8,) and set(found.words) == {8}


def test_where_the_object_leaves_the_picture_nothing_is_carved(masks, cameras):
    """A camera that looks past the object shows a part of it: no contradiction."""
    turned = cameras[2].c2w.clone()
    angle = math.radians(20.0)
    c, s = math.cos(angle), math.sin(angle)
    turned[:3, :3] = turned[:3, :3] @ torch.tensor([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    past = type(cameras[2])(turned, cameras[2].K, SIDE, SIDE)
    cut = torch.cat([masks[:2], balls(past)[None], masks[3:]])
    assert 0.0 < float(cut[2].sum()) < 0.9 * float(masks[2].sum())
    found = agreed(cut, [*cameras[:2], past, *cameras[3:]])
    assert found.words == {} and torch.equal(found.masks, cut)


def test_where_masks_and_cameras_do_not_belong_together_nothing_is_mended_and_it_is_said(masks, cameras):
    moved = torch.stack([mask.roll(25 * (-1) ** k, dims=-2) for k, mask in enumerate(masks)])
    found = agreed(moved, cameras)
    assert torch.equal(found.masks, moved) and found.dropped == ()
    assert len(found.words) > len(masks) / 2 and all("contradict each other" in word for word in found.words.values())


def test_few_masks_tell_nothing_and_a_wrong_shape_is_named(masks, cameras):
    assert agreed(masks[:3], cameras[:3]).words == {}
    with pytest.raises(ValueError, match="V, 1, S, S"):
        agreed(masks[:, 0], cameras)


def test_a_stop_is_heard(masks, cameras):
    def stop(fraction: float, message: str) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        agreed(masks, cameras, stop)
