"""The generator gives LaMa's numbers; the Fourier unit sees everything and needs no half-precision transform."""

import pytest
import torch

from arm_blender.models.ffc import FfcConfig, FfcGenerator, FourierUnit


@pytest.mark.parametrize(("downs", "channels"), [(2, (5, 6)), (3, (4, 3))])
def test_generator_equals_the_published_one(downs, channels, parity):
    fixture = parity(f"lama_ffc_generator_down{downs}")
    generator = FfcGenerator(*channels, FfcConfig(width=8, downs=downs, blocks=2, norm="batch")).eval()
    generator.load_state_dict(fixture.weights)
    assert any(name.startswith("odd") for name in fixture.inputs)  # Rounded up at every halving.
    for size, image in fixture.inputs.items():
        fixture.check(torch.sigmoid(generator(image)), f"image/{size}")


@pytest.mark.parametrize("size", ["even_h8_w10", "odd_h7_w9"])
def test_fourier_unit_equals_the_published_one(size, parity):
    fixture = parity("lama_fourier_unit")
    unit = FourierUnit(6, "batch").eval()
    unit.load_state_dict(fixture.weights)
    fixture.check(unit(fixture.inputs[size]), size)


def test_one_texel_reaches_every_other():
    torch.manual_seed(0)
    unit = FourierUnit(2, "group")
    x = torch.randn(1, 2, 16, 16)
    touched = x.clone()
    touched[0, 0, 3, 5] += 1.0
    with torch.no_grad():
        change = (unit(touched) - unit(x)).abs().sum(1)
    assert (change > 1e-5).float().mean() > 0.99


def test_half_precision_runs_the_transform_in_float32():
    torch.manual_seed(0)
    unit = FourierUnit(4, "group")
    x = torch.randn(1, 4, 9, 12)
    with torch.no_grad():
        expected = unit(x)
        found = unit.bfloat16()(x.bfloat16())
    assert found.dtype == torch.bfloat16
    assert (found.float() - expected).abs().max() < 0.05 * expected.abs().max()


def test_paper_bottleneck_has_512_channels_and_the_published_size():
    """LaMa's generator with these settings and four input channels has 13.8 million parameters."""
    with torch.device("meta"):
        generator = FfcGenerator(4, 6, FfcConfig())
    assert generator.model[8].conv1.ffc.convl2l.out_channels + generator.model[8].conv1.ffc.convl2g.out_channels == 512
    assert sum(p.numel() for p in generator.parameters()) == pytest.approx(13.8e6, rel=0.01)


def test_zero_output_layer_makes_a_zero_output_that_can_learn():
    generator = FfcGenerator(3, 6, FfcConfig(width=4, downs=2, blocks=1))
    torch.nn.init.zeros_(generator.last.weight)
    torch.nn.init.zeros_(generator.last.bias)
    out = generator(torch.rand(1, 3, 16, 16))
    assert not out.any()
    (out - 1.0).square().sum().backward()
    assert generator.last.weight.grad.any()
