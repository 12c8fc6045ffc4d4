"""Transfer functions against the standard's own numbers."""

import pytest
import torch

from arm_blender.graphics.color import bytes_from_unit, composite, linear_from_srgb, srgb_from_linear


def test_mid_grey_is_the_standards():
    # IEC 61966-2-1: sRGB 0.5 is linear 0.21404.
    assert float(linear_from_srgb(torch.tensor(0.5))) == pytest.approx(0.21404, abs=1e-5)


def test_round_trip_keeps_every_8_bit_value():
    values = torch.arange(256) / 255.0
    assert torch.allclose(srgb_from_linear(linear_from_srgb(values)), values, atol=1e-6)


def test_gradient_is_finite_down_to_black():
    linear = torch.zeros(3, requires_grad=True)
    srgb_from_linear(linear).sum().backward()
    assert torch.equal(linear.grad, torch.full((3,), 12.92))


def test_bytes_are_rounded_and_clamped():
    every = torch.arange(256)
    assert torch.equal(bytes_from_unit((every + 0.49) / 255.0), every.byte())
    assert torch.equal(bytes_from_unit((every - 0.49) / 255.0), every.byte())
    assert bytes_from_unit(torch.tensor([-3.0, 2.0, torch.inf])).tolist() == [0, 255, 255]


def test_compositing_keeps_the_opaque_and_shows_the_background_elsewhere():
    color, alpha = torch.rand(3, 2, 2), torch.tensor([[[1.0, 0.0], [0.5, 1.0]]])
    result = composite(color, alpha, 1.0)
    assert torch.equal(result[:, 0, 0], color[:, 0, 0])
    assert torch.equal(result[:, 0, 1], torch.ones(3))
    assert torch.allclose(result[:, 1, 0], 0.5 + 0.5 * color[:, 1, 0])
