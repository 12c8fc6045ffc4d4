"""LPIPS gives the public package's numbers, is zero for equal images, and keeps gradients finite."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from arm_blender.errors import CheckpointError
from training.lpips import Lpips

FOLDER = Path(__file__).parents[1] / "data/parity"
FIXTURE = load_file(FOLDER / "lpips_narrow_vgg.safetensors")
WEIGHTS = {key.removeprefix("weights/"): t for key, t in FIXTURE.items() if key.startswith("weights/")}


@pytest.fixture
def pair():
    """Two images in [0, 1]; the fixture's are in [-1, 1]."""
    return tuple((FIXTURE[f"input/image_{k}"] + 1.0) / 2.0 for k in (0, 1))


@pytest.mark.parametrize("network", ["vgg", "alex"])
def test_distance_equals_the_published_one(network):
    fixture = load_file(FOLDER / f"lpips_narrow_{network}.safetensors")
    distance = Lpips({key.removeprefix("weights/"): t for key, t in fixture.items() if key.startswith("weights/")})
    x, y = ((fixture[f"input/image_{k}"] + 1.0) / 2.0 for k in (0, 1))
    assert distance(x, y).item() == pytest.approx(fixture["output/distance"].mean().item(), rel=1e-5)


def test_equal_images_have_no_distance_and_order_does_not_matter(pair):
    distance, (x, y) = Lpips(WEIGHTS), pair
    assert distance(x, x).item() == 0.0
    assert distance(x, y).item() == pytest.approx(distance(y, x).item())


def test_gradient_is_finite_where_no_feature_answers(pair):
    """Biases far below zero silence every unit: the square root meets zero."""
    silent = {key: t - 100.0 if key.endswith("bias") else t for key, t in WEIGHTS.items()}
    x = pair[0].clone().requires_grad_()
    Lpips(silent)(x, pair[1]).backward()
    assert x.grad.isfinite().all()


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "vgg.safetensors"
    with pytest.raises(CheckpointError, match=r"vgg\.safetensors: no LPIPS weights"):
        Lpips.from_file(path)
    save_file({"weight": torch.zeros(1)}, path)
    with pytest.raises(CheckpointError, match="state dict of lpips"):
        Lpips.from_file(path)
    save_file(WEIGHTS, path)
    assert len(Lpips.from_file(path).heads) == 5
