"""LPIPS at its published width and with its published heads gives the public package's numbers.

The heads belong to others and are not part of this project: the environment variable ARM_PARITY names the folder that
holds them with the numbers (`lpips_fullwidth_*.safetensors`, `lpips_linear_heads.safetensors`). The trunks are too
large to store, and are made anew from the formula by which those numbers were made.
"""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from arm_blender.weight_files.imported import lpips_from_vgg
from training.lpips import Lpips

FOLDER = Path(os.environ.get("ARM_PARITY", ""))
pytestmark = pytest.mark.skipif(
    not (FOLDER / "lpips_linear_heads.safetensors").is_file(), reason="ARM_PARITY names no folder with LPIPS's numbers"
)


def formula(tensor: int, shape: tuple[int, ...], gain: float) -> torch.Tensor:
    """Numbers in [-gain, gain] that anyone can make again: a hash of the tensor's number and the element's."""
    x = np.arange(int(np.prod(shape)), dtype=np.uint64) + np.uint64(2654435761 * (tensor + 1))
    x = x.astype(np.uint32)
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x ^= x >> np.uint32(shift)
        x *= np.uint32(factor)
    x ^= x >> np.uint32(16)
    return torch.from_numpy((2.0 * (x / 2.0**32 - 0.5) * gain).astype(np.float32)).reshape(shape)


def trunk(checks: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The trunk's tensors as `sliceN.M.weight`, each held against its stored shape, beginning and sum."""
    names = {key.removeprefix("weights/check/").rpartition("/")[0] for key in checks if "/check/" in key}
    layers = sorted({name.rpartition(".")[0] for name in names}, key=lambda name: int(name.rpartition(".")[2]))
    made = {}
    for number, layer in enumerate(layers):
        shape = tuple(checks[f"weights/check/{layer}.weight/shape"].tolist())
        gain = float(np.sqrt(6.0 / np.prod(shape[1:])))
        made[f"{layer}.weight"] = formula(2 * number, shape, gain)
        made[f"{layer}.bias"] = formula(2 * number + 1, shape[:1], 0.1)
    for name, tensor in made.items():
        check = {part: checks[f"weights/check/{name}/{part}"] for part in ("shape", "first8", "sum_float64")}
        assert list(tensor.shape) == check["shape"].tolist()
        torch.testing.assert_close(tensor.flatten()[:8], check["first8"], rtol=1e-6, atol=0.0)
        torch.testing.assert_close(tensor.double().sum()[None], check["sum_float64"], rtol=1e-6, atol=1e-6)
    return made


@pytest.fixture(scope="module")
def heads():
    return load_file(FOLDER / "lpips_linear_heads.safetensors")


@pytest.fixture(scope="module", params=["vgg", "alex"])
def published(request, heads):
    """The stored tensors of one network, and its weights as `Lpips` takes them."""
    fixture = load_file(FOLDER / f"lpips_fullwidth_{request.param}.safetensors")
    start = f"weights/{request.param}/"
    state = {key.removeprefix(start): tensor for key, tensor in heads.items() if key.startswith(start)}
    assert all(torch.equal(tensor, fixture[f"weights/{key}"]) for key, tensor in state.items())
    if request.param == "vgg":  # As torchvision names them, through the import.
        state |= {f"features.{key.partition('.')[2]}": tensor for key, tensor in trunk(fixture).items()}
        return fixture, lpips_from_vgg(state, "published").state
    state |= {f"net.{key}": tensor for key, tensor in trunk(fixture).items()}
    return fixture, state | {f"scaling_layer.{part}": heads[f"output/scaling_{part}"] for part in ("shift", "scale")}


def distances(fixture: dict[str, torch.Tensor], weights: dict[str, torch.Tensor]) -> torch.Tensor:
    """Of each stored pair by itself: (pairs,)."""
    x, y = ((fixture[f"input/image_{k}"] + 1.0) / 2.0 for k in (0, 1))
    distance = Lpips(weights)
    return torch.stack([distance(x[k : k + 1], y[k : k + 1]) for k in range(len(x))])


@torch.no_grad()
def test_distance_equals_the_published_one(published):
    fixture, weights = published
    expected = fixture["output/distance"].flatten()
    assert float((distances(fixture, weights) - expected).abs().max()) <= 1e-5 * float(expected.abs().max())


@torch.no_grad()
@pytest.mark.parametrize("layer", range(5))
def test_each_head_adds_what_the_published_one_adds(published, layer):
    """With the other heads at zero."""
    fixture, weights = published
    alone = {
        key: torch.zeros_like(t) if key.startswith("lin") and not key.startswith(f"lin{layer}.") else t
        for key, t in weights.items()
    }
    expected = fixture[f"output/layer_{layer}"].flatten()
    assert float((distances(fixture, alone) - expected).abs().max()) <= 1e-5 * float(expected.abs().max())


def test_imported_scaling_is_the_published_one(published, heads):
    _, weights = published
    for part in ("shift", "scale"):
        torch.testing.assert_close(
            weights[f"scaling_layer.{part}"], heads[f"output/scaling_{part}"], rtol=0.0, atol=0.0
        )
    probe = (heads["input/scaling_probe"] - weights["scaling_layer.shift"]) / weights["scaling_layer.scale"]
    torch.testing.assert_close(probe, heads["output/scaled_probe"], rtol=1e-6, atol=0.0)
