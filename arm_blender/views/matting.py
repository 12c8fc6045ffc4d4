"""The object of a photograph by a network that the user has brought, as ONNX: U2-Net or IS-Net, or what rembg has.

U2-Net (Qin et al. 2020, arXiv 2005.09007) and IS-Net (Qin et al. 2022, arXiv 2203.03041) each take a square of one
size, by which we know them, normalised as they were trained. Their first output is the mask, stretched to 0 to 1.
"""

import functools
import os
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from .. import checkpoints
from ..errors import CheckpointError
from ..graphics.color import bytes_from_unit, srgb_from_linear
from .masks import Unsure, without_specks

WEIGHTS = "matting"
"""The name under which a model is registered."""

_REMBG_MODELS = ("isnet-general-use", "u2net")
"""Those of rembg that know any object, the better one first."""

_NO_CONTRAST = 0.1
"""Range of a network's output below which it has found nothing; stretching would make an object of its noise."""


@dataclass(frozen=True)
class _Convention:
    """What a network takes.

    Attributes:
        mean: of sRGB in [0, 1], after the brightest value has become 1.
        deviation: that it is divided by.
    """

    mean: tuple[float, float, float]
    deviation: tuple[float, float, float]


_CONVENTIONS = {
    320: _Convention((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
    1024: _Convention((0.5, 0.5, 0.5), (1.0, 1.0, 1.0)),
}
"""By the pixels a side of the input: U2-Net, IS-Net."""


def matted_by_model(image: Tensor) -> Tensor:
    """(H, W) alpha of an opaque picture (4, H, W), linear Rec.709, by the model that was imported.

    Raises:
        Unsure: there is none, onnxruntime is not installed, or the model finds nothing.
        CheckpointError: the model is damaged, or of another kind.
    """
    model = checkpoints.shipped(WEIGHTS)
    if not model.is_file():
        raise Unsure("no matting model is there")
    if find_spec("onnxruntime") is None:
        raise Unsure("the matting model needs onnxruntime (pip install onnxruntime)")
    return alpha_by(model, image)


def matted_by_rembg(image: Tensor) -> Tensor:
    """(H, W) alpha of an opaque picture (4, H, W), linear Rec.709, by the package rembg.

    Only with a model that it has downloaded before: here it would do so without asking.

    Raises:
        Unsure: it is not installed, has no model, or finds nothing.
    """
    if find_spec("rembg") is None or find_spec("onnxruntime") is None:
        raise Unsure("rembg is not installed")
    folder = os.environ.get("U2NET_HOME") or Path(os.environ.get("XDG_DATA_HOME", "~")) / ".u2net"
    name = next((n for n in _REMBG_MODELS if (Path(folder).expanduser() / f"{n}.onnx").is_file()), None)
    if name is None:
        raise Unsure("rembg has no model yet (rembg d isnet-general-use)")
    import rembg

    pixels = bytes_from_unit(srgb_from_linear(image[:3])).permute(1, 2, 0).contiguous().numpy()
    found = rembg.remove(pixels, session=_rembg_session(name), only_mask=True)
    return _cleaned(torch.from_numpy(found.astype("float32") / 255.0))


def alpha_by(model: Path, image: Tensor) -> Tensor:
    """(H, W) alpha in [0, 1] of a picture (4, H, W), linear Rec.709, by the network in a file.

    Raises:
        Unsure: the network finds nothing.
        CheckpointError: the file is damaged, or no U2-Net or IS-Net.
    """
    session, side = _session(model, model.stat().st_mtime_ns, torch.get_num_threads())
    convention = _CONVENTIONS[side]
    small = interpolate(srgb_from_linear(image[None, :3]), (side, side), mode="bicubic", antialias=True).clamp(0.0, 1.0)
    small = small / small.max().clamp(min=1e-6)
    mean, deviation = (torch.tensor(v)[:, None, None] for v in (convention.mean, convention.deviation))
    try:
        output = session.run(None, {session.get_inputs()[0].name: ((small - mean) / deviation).numpy()})[0]
    except _failures() as error:
        raise CheckpointError(f"{model}: does not run ({error}); import another model") from error
    if output.ndim != 4 or output.shape[:2] != (1, 1) or min(output.shape) < 1:
        raise CheckpointError(f"{model}: gives {output.shape} instead of one mask; import a U2-Net or an IS-Net")
    mask = torch.from_numpy(output).float()
    low, high = mask.min(), mask.max()
    if not float(high - low) >= _NO_CONTRAST:  # So is what is not a number.
        raise Unsure("the matting model finds no object")
    return _cleaned(interpolate((mask - low) / (high - low), image.shape[1:], mode="bilinear", antialias=True)[0, 0])


def check_model(model: Path) -> None:
    """Raises `CheckpointError` where a file is missing, damaged, no U2-Net or IS-Net, or onnxruntime is."""
    if not model.is_file():
        raise CheckpointError(f"{model}: no such file, check the path")
    if find_spec("onnxruntime") is None:
        raise CheckpointError(f"{model}: onnxruntime is not installed; pip install onnxruntime, and import it again")
    _session(model, model.stat().st_mtime_ns, torch.get_num_threads())


@functools.lru_cache(maxsize=1)
def _session(model: Path, changed: int, threads: int) -> tuple[Any, int]:
    """The network, ready to run, and the pixels a side of its input; the next view finds it loaded.

    Args:
        changed: when the file was; another file under the same name is read anew.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 4  # What goes wrong is raised.
    try:
        session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
    except _failures() as error:
        raise CheckpointError(f"{model}: no readable ONNX model ({error}); download it again") from error
    inputs = session.get_inputs()
    shape = inputs[0].shape if inputs else []
    if len(inputs) != 1 or len(shape) != 4 or shape[1] != 3 or shape[2] != shape[3] or shape[2] not in _CONVENTIONS:
        raise CheckpointError(
            f"{model}: takes {[entry.shape for entry in inputs]}; "
            "import a U2-Net (3x320x320) or an IS-Net (3x1024x1024)"
        )
    return session, shape[2]


@functools.lru_cache(maxsize=1)
def _rembg_session(name: str) -> Any:
    import rembg

    return rembg.new_session(name)


def _cleaned(alpha: Tensor) -> Tensor:
    """`alpha` (H, W) without the tiny parts; soft edges stay."""
    opaque = alpha > 0.5
    return alpha * ~(opaque & ~without_specks(opaque))


def _failures() -> tuple[type[Exception], ...]:
    """What onnxruntime raises; its exceptions have no base of their own."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    return tuple(kind for kind in vars(state).values() if isinstance(kind, type) and issubclass(kind, Exception))
