"""The move of a logit that measured materials ask for."""

import pytest
import torch

from training.stages.glossyrm_calibration import MOST, shift


def test_the_move_is_found_that_made_the_truth():
    generator = torch.Generator().manual_seed(0)
    logits = [torch.randn(200, generator=generator) for _ in range(3)]
    assert shift(logits, [(x - 1.3).sigmoid() for x in logits]) == pytest.approx(-1.3, abs=0.03)


def test_every_object_counts_alike_and_the_move_is_bounded():
    few, many = torch.zeros(5), torch.zeros(5000)
    truth = [torch.zeros(5), torch.zeros(5), torch.ones(5000)]
    assert shift([few, few, many], truth) == pytest.approx(-MOST)  # Two objects of three.
    assert shift([many], [torch.ones(5000)]) == pytest.approx(MOST)
