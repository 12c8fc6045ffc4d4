"""A matting model gets what it was trained on, and its mask comes back in the picture's own size."""

import sys
from types import ModuleType

import numpy as np
import pytest
import torch
from PIL import Image

from arm_blender.errors import CheckpointError
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.views import matting
from arm_blender.views.masks import Unsure
from arm_blender.weight_files import checkpoints
from arm_blender.weight_files import matting_model as matting_model_file

TRAINED = {320: ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)), 1024: ((0.5, 0.5, 0.5), (1.0, 1.0, 1.0))}
"""Mean and deviation, from the inference scripts of U2-Net and IS-Net."""


@pytest.fixture
def photograph() -> torch.Tensor:
    """A red square on a ground of many colours, none of them red, and none bright."""
    srgb = 0.8 * torch.rand(3, 15, 20, generator=torch.Generator().manual_seed(0)).repeat_interleave(8, 1)
    srgb = srgb.repeat_interleave(8, 2)
    srgb[0] *= 0.2
    srgb[:, 40:80, 56:120] = torch.tensor([0.8, 0.1, 0.1])[:, None, None]
    return torch.cat([linear_from_srgb(srgb), torch.ones(1, 120, 160)])


@pytest.mark.parametrize("side", [320, 1024])
def test_the_model_sees_what_it_was_trained_on(photograph, tmp_path, matting_model, side):
    """Against the published steps, done by Pillow and numpy."""
    w, b = (1.0, -0.7, 0.4), 0.3
    found = matting.alpha_by(matting_model(tmp_path / "m.onnx", side, w, b), photograph)
    srgb = photograph[:3].clamp(0, 1).permute(1, 2, 0).numpy()
    srgb = np.where(srgb <= 0.0031308, 12.92 * srgb, 1.055 * np.maximum(srgb, 0.0031308) ** (1 / 2.4) - 0.055)
    planes = [Image.fromarray(srgb[..., k].astype(np.float32)).resize((side, side), Image.BICUBIC) for k in range(3)]
    small = np.stack([np.asarray(plane) for plane in planes]).clip(0, 1)
    mean, deviation = (np.array(value)[:, None, None] for value in TRAINED[side])
    mask = np.maximum(((small / small.max() - mean) / deviation * np.array(w)[:, None, None]).sum(0) + b, 0.0)
    mask = (mask - mask.min()) / (mask.max() - mask.min())
    expected = np.asarray(Image.fromarray(mask.astype(np.float32)).resize((160, 120), Image.BILINEAR))
    # Specks of the mask that are less than a hundredth of its largest part are gone; none is here.
    np.testing.assert_allclose(found.numpy(), expected, atol=2e-3)


def test_the_imported_model_finds_the_object(photograph, weights_folder, matting_model):
    with pytest.raises(Unsure, match="no matting model"):
        matting.matted_by_model(photograph)
    matting_model(checkpoints.shipped("matting"))
    mask = matting.matted_by_model(photograph) > 0.5
    expected = torch.zeros(120, 160, dtype=torch.bool)
    expected[40:80, 56:120] = True
    assert int((mask ^ expected).sum()) < 0.02 * int(expected.sum())


def test_a_model_that_finds_nothing_is_not_stretched(photograph, tmp_path, matting_model):
    with pytest.raises(Unsure, match="finds no object"):
        matting.alpha_by(matting_model(tmp_path / "m.onnx", w=(1e-3, 1e-3, 1e-3)), photograph)
    with pytest.raises(Unsure, match="finds no object"):
        matting.alpha_by(matting_model(tmp_path / "n.onnx", b=float("nan")), photograph)


@pytest.mark.parametrize(
    ("how", "line"),
    [({"side": 512}, "512, 512.*3x320x320"), ({"side": "any"}, "any.*3x320x320"), ({"channels": 1}, "1, 320, 320")],
    ids=["size", "dynamic", "channels"],
)
def test_another_network_is_refused_by_what_it_takes(tmp_path, matting_model, how, line):
    with pytest.raises(CheckpointError, match=f"m.onnx: takes .*{line}"):
        matting_model_file.check_model(matting_model(tmp_path / "m.onnx", **how))


@pytest.mark.parametrize("content", [b"", b"no model", None], ids=["empty", "text", "missing"])
def test_what_is_no_model_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "m.onnx").write_bytes(content)
    with pytest.raises(CheckpointError, match="m.onnx: no "):
        matting_model_file.check_model(tmp_path / "m.onnx")


def test_a_model_that_was_replaced_is_read_anew(photograph, tmp_path, matting_model):
    first = matting.alpha_by(matting_model(tmp_path / "m.onnx"), photograph)
    second = matting.alpha_by(matting_model(tmp_path / "m.onnx", w=(-1.0, 1.0, 0.0), b=3.0), photograph)
    assert float((first - second).abs().max()) > 0.5


def test_without_onnxruntime_the_line_says_so(photograph, weights_folder, matting_model, monkeypatch):
    path = matting_model(checkpoints.shipped("matting"))
    for module in (matting, matting_model_file):
        monkeypatch.setattr(module, "find_spec", lambda name: None)
    with pytest.raises(Unsure, match="pip install onnxruntime"):
        matting.matted_by_model(photograph)
    with pytest.raises(CheckpointError, match="pip install onnxruntime"):
        matting_model_file.check_model(path)


@pytest.fixture
def rembg(monkeypatch, tmp_path) -> ModuleType:
    """The package's two functions; the mask is where red is strong. Its folder of models is still empty."""
    package = ModuleType("rembg")
    package.new_session = lambda name: f"session of {name}"
    package.sessions = []

    def remove(pixels, session, only_mask):
        assert only_mask and pixels.dtype == np.uint8 and pixels.shape == (120, 160, 3)
        package.sessions.append(session)
        return np.where(pixels[..., 0] > 180, 255, 0).astype(np.uint8)

    package.remove = remove
    monkeypatch.setitem(sys.modules, "rembg", package)
    monkeypatch.setattr(matting, "find_spec", lambda name: package)
    monkeypatch.setenv("U2NET_HOME", str(tmp_path))
    matting._rembg_session.cache_clear()
    yield package
    matting._rembg_session.cache_clear()


def test_rembg_is_used_with_the_models_it_has_and_downloads_none(photograph, rembg, tmp_path):
    with pytest.raises(Unsure, match="rembg has no model yet"):
        matting.matted_by_rembg(photograph)
    for name in ("u2net", "isnet-general-use"):
        (tmp_path / f"{name}.onnx").touch()
        mask = matting.matted_by_rembg(photograph) > 0.5
        assert int(mask.sum()) == 40 * 64 and bool(mask[40:80, 56:120].all())
    assert rembg.sessions == ["session of u2net", "session of isnet-general-use"]


def test_without_rembg_it_says_so(photograph):
    with pytest.raises(Unsure, match="rembg is not installed"):
        matting.matted_by_rembg(photograph)
