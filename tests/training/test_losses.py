"""The losses: closed forms, scikit-image as the independent twin, and what lies outside the mask does not count."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from training.losses import ImageLossConfig, SurfaceMaps, geometry_loss, image_loss, similarity

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


def surface(*shape: int, seed: int = 0) -> SurfaceMaps:
    normal = torch.nn.functional.normalize(images(seed, shape[0], 3, *shape[1:]) - 0.5, dim=1)
    return SurfaceMaps(torch.ones(shape, dtype=torch.float64), 2.0 + images(seed + 1, *shape), normal)


def test_a_shape_that_is_true_costs_nothing_and_each_error_its_weight():
    truth = surface(2, 8, 8)
    assert float(sum(geometry_loss(truth, truth).values())) == pytest.approx(0.0, abs=1e-12)
    wrong = SurfaceMaps(truth.mask - 0.5, 0.5 * (truth.depth + 0.3), -truth.normal)
    found = {name: float(term) for name, term in geometry_loss(wrong, truth).items()}
    assert found == pytest.approx({"depth": 0.5 * 0.5 * 0.3, "mask": 0.25, "normal": 0.5 * 0.2 * 2.0})


def test_what_lies_behind_the_object_does_not_count_but_in_the_mask():
    """The far plane may be infinity or any number; gradients are finite, and none reaches depth or normal there."""
    truth, found = surface(1, 8, 8), surface(1, 8, 8, seed=5)
    mask, depth = truth.mask.clone(), truth.depth.clone()
    mask[:, 4:], depth[:, 4:] = 0.0, torch.inf
    leaves = [x.clone().requires_grad_() for x in (found.mask, found.depth, found.normal)]
    terms = geometry_loss(SurfaceMaps(*leaves), SurfaceMaps(mask, depth, truth.normal))
    sum(terms.values()).backward()
    assert all(bool(x.grad.isfinite().all()) for x in leaves)
    assert leaves[0].grad[:, 4:].any() and not leaves[1].grad[:, 4:].any() and not leaves[2].grad[..., 4:, :].any()
    far = depth.clone()
    far[:, 4:] = 1e30
    again = geometry_loss(found, SurfaceMaps(mask, far, truth.normal))
    assert all(float(again[name]) == float(terms[name].detach()) for name in terms)


def test_without_an_object_only_the_mask_is_compared():
    found, nothing = surface(1, 8, 8), torch.full((1, 8, 8), torch.inf, dtype=torch.float64)
    terms = geometry_loss(found, SurfaceMaps(torch.zeros_like(nothing), nothing, torch.zeros_like(found.normal)))
    assert {name: float(term) for name, term in terms.items()} == {"depth": 0.0, "mask": 1.0, "normal": 0.0}


def test_normals_are_compared_as_pictures_where_a_perceptual_distance_is_given():
    truth, found = surface(1, 8, 8), surface(1, 8, 8, seed=3)
    seen = []

    def distance(x, y):
        seen.extend((x, y))
        return (x - y).abs().mean()

    term = geometry_loss(found, truth, perceptual=distance)["normal"]
    assert float(term) == pytest.approx(0.2 * float((found.normal - truth.normal).abs().mean()) / 2.0)
    assert all(0.0 <= float(x.min()) and float(x.max()) <= 1.0 for x in seen)


def test_maps_of_other_shapes_are_refused():
    with pytest.raises(ValueError, match="mask"):
        geometry_loss(surface(1, 8, 8), surface(2, 8, 8))
