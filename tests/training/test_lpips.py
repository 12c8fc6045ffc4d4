"""LPIPS gives the public package's numbers, is zero for equal images, and keeps gradients finite."""

import functools
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from arm_blender.__main__ import main
from arm_blender.errors import CheckpointError
from arm_blender.weight_files import imported
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


@pytest.fixture
def narrow(monkeypatch):
    """Imports networks of the fixture's width."""
    config = imported.LpipsConfig((8, 12, 16, 20, 20))
    convert = functools.partial(imported.lpips_from_vgg, config=config)
    monkeypatch.setitem(imported.KINDS, "lpips", ("lpips.vgg", convert))


def test_the_packages_own_weights_give_its_distance(pair, narrow, tmp_path, weights_folder):
    torch.save(WEIGHTS, tmp_path / "lpips.pth")
    assert main(["weights", "import", str(tmp_path / "lpips.pth"), "--as", "lpips"]) == 0
    distance = Lpips.from_file(weights_folder / "lpips.vgg.safetensors")
    assert distance(*pair).item() == pytest.approx(FIXTURE["output/distance"].item(), rel=1e-5)


def test_the_two_published_files_are_joined(pair, narrow, tmp_path, weights_folder):
    """torchvision's network and the heads; the normalisation is in neither."""
    trunk = {f"features.{key.partition('.slice')[2][2:]}": t for key, t in WEIGHTS.items() if "slice" in key}
    torch.save(trunk | {"classifier.0.bias": torch.zeros(4)}, tmp_path / "vgg16-397923af.pth")
    assert main(["weights", "import", str(tmp_path)]) == 1  # One of the two is not enough.
    torch.save({key: t for key, t in WEIGHTS.items() if key.startswith("lin")}, tmp_path / "vgg.pth")
    assert main(["weights", "import", str(tmp_path)]) == 0
    distance = Lpips.from_file(weights_folder / "lpips.vgg.safetensors")
    shift, scale = torch.tensor([[-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]])[:, None, :, None, None]
    expected = Lpips(WEIGHTS | {"scaling_layer.shift": shift, "scaling_layer.scale": scale})
    assert distance(*pair).item() == pytest.approx(expected(*pair).item(), rel=1e-6)


def test_half_of_lpips_is_refused_by_name(narrow, tmp_path, weights_folder):
    torch.save({key: t for key, t in WEIGHTS.items() if key != "net.slice1.0.bias"}, tmp_path / "half.pth")
    with pytest.raises(CheckpointError, match=r"half.pth: net\.slice1\.0\.bias is missing"):
        imported.import_weights(tmp_path / "half.pth", "lpips")
