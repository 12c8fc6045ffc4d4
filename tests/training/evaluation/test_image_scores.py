"""Scores of pictures, against closed forms."""

import math

import pytest
import torch

from training.evaluation.scores.image_scores import (
    PSNR_CAP,
    ViewMoments,
    best_constant,
    compare_pictures,
    constant_score,
    mask_overlap,
    moments,
)

SIDE = 24


@pytest.fixture
def square():
    """(2, 1, N, N): a square of a quarter of the picture in both views."""
    alpha = torch.zeros(2, 1, SIDE, SIDE)
    alpha[..., 6:18, 6:18] = 1.0
    return alpha


def random_pictures(channels: int = 3) -> torch.Tensor:
    return torch.rand(2, channels, SIDE, SIDE, generator=torch.Generator().manual_seed(0))


def test_the_truth_against_itself_reaches_every_bound(square):
    truth = random_pictures()
    scores = compare_pictures(truth, truth, square, square, perceptual=lambda x, y: (x - y).abs().mean())
    assert scores.psnr_in == scores.psnr_full == PSNR_CAP
    assert scores.ssim == pytest.approx(1.0) and scores.lpips == 0.0


def test_the_background_flatters_by_its_share_of_the_picture(square):
    truth = 0.8 * random_pictures()
    scores = compare_pictures(truth + 0.1, truth, square, square)
    assert scores.psnr_in == pytest.approx(20.0, abs=1e-4)
    assert scores.psnr_full == pytest.approx(20.0 + 10.0 * math.log10(4.0), abs=1e-4)


def test_what_lies_outside_of_both_masks_does_not_count(square):
    truth = random_pictures()
    found = torch.where(square > 0.0, truth, torch.nan)
    noisy = torch.where(square > 0.0, truth, 0.3)
    assert compare_pictures(noisy, truth, square, square).psnr_full == PSNR_CAP
    assert compare_pictures(found, truth, square, square).psnr_in == PSNR_CAP


def test_views_without_a_common_pixel_score_nothing_and_stay_in_the_mean(square):
    truth, moved = random_pictures(), square.clone()
    moved[0] = square[0].roll(12, dims=1)
    assert compare_pictures(truth, truth, moved, square).psnr_in == pytest.approx(PSNR_CAP / 2.0)
    assert mask_overlap(moved, square) == pytest.approx(0.5)


def test_overlap_is_intersection_over_union(square):
    shifted = square.roll(3, dims=3)  # 12 columns, 3 of them outside on either side.
    assert mask_overlap(shifted, square) == pytest.approx(9.0 / 15.0)
    assert mask_overlap(torch.zeros_like(square), torch.zeros_like(square)) == 1.0


def test_the_cap_is_per_view(square):
    truth = 0.5 * random_pictures()
    found = truth.clone()
    found[1] += 0.1
    assert compare_pictures(found, truth, square, square).psnr_in == pytest.approx((PSNR_CAP + 20.0) / 2.0, abs=1e-4)


def test_moments_tell_what_a_constant_scores(square):
    truth = random_pictures(1)
    found = torch.full_like(truth, 0.37)
    direct = compare_pictures(found, truth, square, square).psnr_in
    assert constant_score([moments(truth, square, square)], 0.37) == pytest.approx(direct, abs=1e-4)


def test_the_best_constant_of_one_view_is_its_mean_and_no_other_beats_it():
    view = ViewMoments(mean=0.42, square=0.42**2 + 0.01)
    constant, score = best_constant([[view]])
    assert constant == pytest.approx(0.42) and score == pytest.approx(20.0)
    many = [[ViewMoments(0.1, 0.02)], [ViewMoments(0.8, 0.7), ViewMoments(0.6, 0.4)]]
    constant, score = best_constant(many)
    assert all(constant_score(many, step / 100.0) <= score for step in range(101))


def test_pictures_of_another_shape_are_refused(square):
    with pytest.raises(ValueError, match="truth"):
        compare_pictures(random_pictures(3), random_pictures(1), square, square)
