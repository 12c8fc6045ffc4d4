"""The per-view network keeps the atlas's size, reads no other item, and needs gaps to be told apart by its mask."""

import pytest
import torch

from arm_blender.models.unet import Unet, UnetConfig


@pytest.mark.parametrize(("stride", "side"), [(1, 24), (2, 12)])
def test_output_has_the_size_of_the_input_over_the_stem(stride, side):
    config = UnetConfig((4, 8, 16), 5, stride)
    with torch.no_grad():
        assert Unet(3, config)(torch.rand(1, 3, 24, 24)).shape == (1, 5, side, side)
    assert config.multiple == 4 * stride


def test_items_of_a_batch_do_not_mix():
    torch.manual_seed(0)
    unet = Unet(3, UnetConfig((4, 8), 5)).eval()
    x = torch.rand(3, 3, 16, 16)
    with torch.no_grad():
        assert torch.allclose(unet(x)[1:2], unet(x[1:2]), atol=1e-6)


def test_a_texel_sees_as_far_as_the_coarsest_level():
    torch.manual_seed(0)
    unet = Unet(1, UnetConfig((4, 8, 8), 1))
    x = torch.rand(1, 1, 64, 64, requires_grad=True)
    unet(x)[0, 0, 32, 32].backward()
    reach = x.grad[0, 0].abs() > 1e-12
    assert reach[32, 32]
    assert reach.any(dim=1).sum() > 15  # Three levels of 3x3 convolutions with two halvings.


def test_every_part_learns():
    torch.manual_seed(0)
    unet = Unet(3, UnetConfig((4, 8, 16), 5, 2))
    unet(torch.rand(2, 3, 16, 16)).square().sum().backward()
    assert [name for name, p in unet.named_parameters() if p.grad is None or not p.grad.any()] == []
