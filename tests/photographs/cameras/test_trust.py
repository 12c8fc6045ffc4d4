"""A right solution is good; every kind of wrong one is noticed."""

from dataclasses import replace

import pytest
import torch

from arm_blender.graphics.similarity import similarity
from arm_blender.photographs.cameras.trust import (
    MASKS_APART,
    Trust,
    borne_out,
    compared,
    distance_apart,
    judged,
    seen_around,
)
from arm_blender.photographs.masks.joint_hull import JointHull, joint_hull

from .solutions import LENS, box, masks_of, solution, w2c_ring

HALF = (0.9, 0.5, 0.3)


@pytest.fixture
def right():
    return solution(w2c_ring(12), box(HALF, 4))


@pytest.fixture
def masks(right):
    return masks_of(right.w2c, box(HALF))


def hull_of(found, masks):
    return joint_hull(found.w2c, found.lenses, masks)


def moved(found, share: float):
    """The solution with every second camera turned about the object by `share` of a full turn."""
    w2c = found.w2c.clone()
    angle = torch.tensor(2.0 * torch.pi * share)
    turn = torch.eye(4, dtype=torch.float64)
    turn[:2, :2] = torch.tensor([[angle.cos(), -angle.sin()], [angle.sin(), angle.cos()]])
    w2c[::2] = w2c[::2] @ turn
    return replace(found, w2c=w2c)


def test_a_right_solution_is_good(right, masks):
    trust = judged(right, 12, hull_of(right, masks))
    assert trust.level == "good" and not trust.reasons
    assert compared(trust, right, right).level == "good"


def test_without_masks_it_is_doubtful(right):
    assert judged(right, 12, None).level == "doubtful"


def test_the_hull_of_right_cameras_is_the_object(right, masks):
    hull = hull_of(right, masks)
    assert float(hull.agreement.min()) > 0.85
    # Seen by a ring from above, a hull is larger than its object, never smaller.
    for side, half in zip(hull.core.amax(dim=0)[:2], HALF[:2], strict=True):
        assert half - 0.03 <= float(side) <= half + 0.2


def test_turned_cameras_contradict_the_masks(right, masks):
    wrong = moved(right, 0.25)
    trust = judged(wrong, 12, hull_of(wrong, masks))
    assert trust.level != "good" and "the masks of the object do not fit together" in trust.reasons


def test_masks_of_other_pictures_are_noticed(right):
    masks = masks_of(right.w2c, box((1.2, 0.2, 0.2)))
    assert judged(right, 12, hull_of(right, masks)).level == "good"
    wrong = replace(right, w2c=right.w2c[torch.randperm(12, generator=torch.Generator().manual_seed(1))])
    assert judged(wrong, 12, hull_of(wrong, masks)).level != "good"


@pytest.mark.parametrize(("allowed", "level"), [(0.95, "good"), (0.8, "doubtful"), (0.4, "wrong")])
def test_matches_that_are_thrown_away_speak_against_it(right, masks, allowed, level):
    found = solution(right.w2c, right.points, allowed)
    assert judged(found, 12, hull_of(found, masks)).level == level


@pytest.mark.parametrize(("count", "level"), [(14, "good"), (20, "doubtful"), (40, "wrong")])
def test_pictures_without_a_camera_speak_against_it(right, masks, count, level):
    assert judged(right, count, hull_of(right, masks)).level == level


def test_three_cameras_are_too_few():
    few = solution(w2c_ring(3), box(HALF, 4))
    assert judged(few, 3, joint_hull(few.w2c, (LENS,) * 3, masks_of(few.w2c, box(HALF)))).level == "wrong"


def test_a_second_solution_that_differs_is_noticed(right, masks):
    trust = judged(right, 12, hull_of(right, masks))
    shuffled = right.w2c[torch.randperm(12, generator=torch.Generator().manual_seed(1))]
    assert compared(trust, right, replace(right, w2c=shuffled)).level == "doubtful"
    assert compared(judged(right, 12, None), right, replace(right, w2c=shuffled)).level == "wrong"
    assert compared(trust, right, None).level == "doubtful"
    assert compared(judged(right, 12, None), right, None).level == "wrong"


def test_the_same_cameras_in_another_frame_are_the_same(right):
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(0)).double())
    turn = turn * torch.sign(torch.linalg.det(turn))
    other = right.w2c.clone()
    other[:, :3, :3] = right.w2c[:, :3, :3] @ turn.T
    other[:, :3, 3] = 2.5 * right.w2c[:, :3, 3]
    assert distance_apart(right, replace(right, w2c=other)) < 1e-9


def test_a_similarity_is_found_again():
    source = torch.randn(9, 3, generator=torch.Generator().manual_seed(2)).double()
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(3)).double())
    turn = turn * torch.sign(torch.linalg.det(turn))
    shift = torch.tensor([1.0, -2.0, 0.5]).double()
    scale, rotation, found = similarity(source, 0.7 * source @ turn.T + shift)
    assert scale == pytest.approx(0.7)
    torch.testing.assert_close(rotation, turn)
    torch.testing.assert_close(found, shift)


@pytest.fixture
def doubted(right):
    """A right solution whose first masks fit badly."""
    return Trust("doubtful", (MASKS_APART,), judged(right, 12, None).measures | {"agreement": 0.6})


@pytest.mark.parametrize(("agreement", "level"), [(0.9, "good"), (0.78, "doubtful")])
def test_masks_that_all_pictures_tell_bear_a_solution_out_where_they_fit_well(doubted, agreement, level):
    hull = JointHull(torch.zeros(1, 3), torch.zeros(1, 3), 0.1, torch.full((8,), agreement))
    found = borne_out(doubted, hull)
    assert doubted.doubts_masks_alone and found.level == level
    assert found.measures["agreement together"] == pytest.approx(agreement)
    assert found.reasons == (() if level == "good" else (MASKS_APART,))
    assert borne_out(doubted, None).level == "doubtful"


@pytest.mark.parametrize(("agreement", "enough"), [(0.6, False), (0.7, True)])
def test_bad_masks_alone_ask_for_no_other_attempt_where_cameras_are_likely_right(doubted, agreement, enough):
    trust = Trust(doubted.level, doubted.reasons, doubted.measures | {"agreement": agreement})
    assert trust.needs_no_other == enough
    assert not Trust("doubtful", ("many matches",), trust.measures).needs_no_other


def test_other_doubts_are_not_for_masks_to_lift(doubted):
    assert not Trust("doubtful", (MASKS_APART, "many matches"), {}).doubts_masks_alone
    assert not Trust("wrong", (MASKS_APART,), {}).doubts_masks_alone


@pytest.mark.parametrize(
    ("cameras", "unseen"),
    [
        (w2c_ring(12), 0.0),
        (w2c_ring(12, elevation=1.0), 0.0),
        (w2c_ring(24)[:12], 0.11),
        (w2c_ring(24)[:5], 0.4),
        (w2c_ring(1), 0.56),
    ],
)
def test_pictures_from_one_side_are_doubtful(right, cameras, unseen):
    """A camera sees a side up to 78 degrees from its normal: half a ring sees all but a ninth."""
    good = judged(right, 12, None).measures
    trust = seen_around(Trust("good", (), good), torch.linalg.inv(cameras)[:, :3, 3])
    assert trust.measures["sides unseen"] == pytest.approx(unseen, abs=0.03)
    assert trust.level == ("good" if unseen < 0.2 else "doubtful")
    assert (trust.reasons == ()) == (unseen < 0.2)
