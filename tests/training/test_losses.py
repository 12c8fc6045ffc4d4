"""The image loss: closed forms, scikit-image as the independent twin, and what lies outside the mask does not count."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from training.losses import ImageLossConfig, image_loss, similarity

ONLY_SQUARED = ImageLossConfig(squared=1.0, structure=0.0)


def images(seed: int, *shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_structure_equals_scikit_image():
    x = images(0, 2, 3, 24, 31)
    y = (0.7 * x + 0.3 * images(1, 2, 3, 24, 31)).clamp(0, 1)
    found = similarity(x, y).mean(dim=(1, 2, 3))
    for view in range(2):
        a, b = (np.moveaxis(t[view].numpy(), 0, -1) for t in (x, y))
        expected = structural_similarity(
            a, b, channel_axis=-1, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
        assert found[view].item() == pytest.approx(expected, abs=1e-9)


def test_equal_images_cost_nothing_and_different_ones_something():
    x, mask = images(0, 2, 3, 16, 16), torch.ones(2, 16, 16, dtype=torch.bool)
    assert image_loss(x, x, mask).item() == pytest.approx(0.0, abs=1e-12)
    assert image_loss(x, images(1, 2, 3, 16, 16), mask) > 0.05


def test_squared_error_of_constants_is_closed_form():
    mask = torch.zeros(1, 16, 16, dtype=torch.bool)
    mask[0, 4:9, 4:9] = True
    x, y = torch.full((1, 1, 16, 16), 0.5), torch.full((1, 1, 16, 16), 0.2)
    assert image_loss(x, y, mask, ONLY_SQUARED).item() == pytest.approx(0.09)


def test_outside_of_the_mask_does_not_count():
    x, y = images(0, 2, 3, 24, 24), images(1, 2, 3, 24, 24)
    mask = torch.zeros(2, 24, 24, dtype=torch.bool)
    mask[:, 6:18, 6:18] = True
    elsewhere = torch.where(mask[:, None], x, images(2, 2, 3, 24, 24))
    assert torch.equal(image_loss(x, y, mask), image_loss(elsewhere, y, mask))


def test_empty_mask_gives_zero_with_a_finite_gradient():
    x = images(0, 1, 3, 16, 16).requires_grad_()
    loss = image_loss(x, images(1, 1, 3, 16, 16), torch.zeros(1, 16, 16, dtype=torch.bool))
    loss.backward()
    assert loss.item() == 0.0
    assert not x.grad.any()


def test_perceptual_term_is_added_with_its_weight_and_sees_three_channels():
    x, mask = images(0, 2, 1, 16, 16), torch.ones(2, 16, 16, dtype=torch.bool)
    seen = []

    def distance(a, b):
        seen.append((a.shape, b.shape))
        return torch.tensor(2.0)

    plain = image_loss(x, x, mask)
    assert image_loss(x, x, mask, perceptual=distance).item() == pytest.approx(plain.item() + 0.3 * 2.0)
    assert seen == [((2, 3, 16, 16), (2, 3, 16, 16))]


def test_gradient_matches_finite_differences():
    x, y = images(0, 1, 1, 12, 12).requires_grad_(), images(1, 1, 1, 12, 12)
    mask = torch.ones(1, 12, 12, dtype=torch.bool)
    assert torch.autograd.gradcheck(lambda t: image_loss(t, y, mask), (x,))


def test_shapes_that_differ_are_named():
    with pytest.raises(ValueError, match=r"mask \(1, 4, 4\)"):
        image_loss(torch.zeros(1, 3, 16, 16), torch.zeros(1, 3, 16, 16), torch.zeros(1, 4, 4, dtype=torch.bool))
