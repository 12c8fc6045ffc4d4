"""The generator gives LaMa's numbers; the Fourier unit sees everything and needs no half-precision transform."""

import math

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

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


class Transforms(TorchFunctionMode):
    """Notes what enters and leaves Fourier transforms."""

    def __init__(self) -> None:
        super().__init__()
        self.types = []

    def __torch_function__(self, function, types, args=(), kwargs=None):
        result = function(*args, **(kwargs or {}))
        if function in (torch.fft.rfft2, torch.fft.irfft2):
            self.types += [args[0].dtype, result.dtype]
        return result


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_autocast_leaves_the_transform_in_single_precision(dtype):
    torch.manual_seed(0)
    generator, x = FfcGenerator(3, 6, FfcConfig(width=8, downs=2, blocks=1)).eval(), torch.rand(1, 3, 36, 20)
    with torch.no_grad(), Transforms() as transforms:
        expected = generator(x)
        with torch.autocast("cpu", dtype):
            found = generator(x).float()
    assert transforms.types == [torch.float32, torch.complex64, torch.complex64, torch.float32] * 4
    assert (found - expected).abs().max() < 0.05 * expected.abs().max()


def test_double_precision_stays_double():
    """A float32 transform within would leave errors of 1e-7."""
    torch.manual_seed(0)
    unit, x = FourierUnit(4, "group").double(), torch.randn(1, 4, 6, 7, dtype=torch.float64)
    with torch.no_grad():
        torch.testing.assert_close(unit(x), by_matrices(unit, x), rtol=0.0, atol=1e-12)


def by_matrices(unit: FourierUnit, x: Tensor) -> Tensor:
    """The Fourier unit by its formula: a transform is a matrix of roots of unity."""
    height, width = x.shape[-2:]

    def roots(count: int) -> Tensor:
        step = torch.arange(count, dtype=torch.float64)
        return torch.exp(-2j * math.pi * step[:, None] * step / count) / math.sqrt(count)

    half = width // 2 + 1
    spectrum = roots(height) @ x.to(torch.complex128) @ roots(width)[:, :half]
    parts = torch.view_as_real(spectrum).movedim(-1, 2).flatten(1, 2).to(x.dtype)
    parts = torch.relu(unit.bn(unit.conv_layer(parts))).unflatten(1, (-1, 2))
    spectrum = roots(height).conj() @ torch.complex(parts[:, :, 0], parts[:, :, 1]).to(torch.complex128)
    # A real picture's other half of the columns are conjugates: each but the first and the middle one counts twice.
    twice = torch.full((half,), 2.0, dtype=torch.float64)
    twice[0] = 1.0
    if width % 2 == 0:
        twice[-1] = 1.0
    return ((spectrum * twice) @ roots(width).conj()[:half]).real.to(x.dtype)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 1), (3, 5), (13, 11), (8, 9), (9, 8)])
def test_odd_sizes_are_transformed_by_the_same_formula(size):
    torch.manual_seed(0)
    unit, x = FourierUnit(4, "group"), torch.randn(2, 4, *size)
    with torch.no_grad():
        found = unit(x)
        assert found.shape == x.shape
        torch.testing.assert_close(found, by_matrices(unit, x), rtol=0.0, atol=2e-6)


@pytest.mark.parametrize("size", [(31, 47), (17, 40), (9, 9)])
def test_the_generator_rounds_odd_sizes_up_and_stays_finite(size):
    torch.manual_seed(0)
    generator = FfcGenerator(3, 6, FfcConfig(width=8, downs=2, blocks=1))
    x = torch.rand(1, 3, *size, requires_grad=True)
    out = generator(x)
    assert out.shape == (1, 6, *(-(-side // 4) * 4 for side in size))
    out.square().sum().backward()
    assert out.isfinite().all() and x.grad.isfinite().all() and x.grad.any()


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
