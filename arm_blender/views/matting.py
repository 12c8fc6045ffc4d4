"""The object of a photograph by a network that the user has brought, as ONNX: U2-Net or IS-Net, or what rembg has.

U2-Net (Qin et al. 2020, arXiv 2005.09007) and IS-Net (Qin et al. 2022, arXiv 2203.03041) each take a square of one
size, by which we know them, normalised as they were trained. Their first output is the mask, stretched to 0 to 1.
"""

import functools
import os
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from ..errors import CheckpointError
from ..graphics.color import bytes_from_unit, srgb_from_linear
from ..weight_files import checkpoints, matting_model
from .masks import Unsure, without_specks

_REMBG_MODELS = ("isnet-general-use", "u2net")
"""Those of rembg that know any object, the better one first."""

_NO_CONTRAST = 0.1
"""Range of a network's output below which it has found nothing; stretching would make an object of its noise."""


_CONVENTIONS = {
    320: ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
    1024: ((0.5, 0.5, 0.5), (1.0, 1.0, 1.0)),
}
"""By the pixels a side of the input (`matting_model.SIDES`): U2-Net, IS-Net. Of each the mean of sRGB in [0, 1], after
the brightest value has become 1, and the deviation that it is divided by."""


def matted_by_model(image: Tensor) -> Tensor:
    """(H, W) alpha of an opaque picture (4, H, W), linear Rec.709, by the model that was imported.

    Raises:
        Unsure: there is none, onnxruntime is not installed, or the model finds nothing.
        CheckpointError: the model is damaged, or of another kind.
    """
    model = checkpoints.shipped(matting_model.MATTING)
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
    session, side = matting_model.opened(model, torch.get_num_threads())
    small = interpolate(srgb_from_linear(image[None, :3]), (side, side), mode="bicubic", antialias=True).clamp(0.0, 1.0)
    small = small / small.max().clamp(min=1e-6)
    mean, deviation = (torch.tensor(v)[:, None, None] for v in _CONVENTIONS[side])
    try:
        output = session.run(None, {session.get_inputs()[0].name: ((small - mean) / deviation).numpy()})[0]
    except matting_model.failures() as error:
        raise CheckpointError(f"{model}: does not run ({error}); import another model") from error
    if output.ndim != 4 or output.shape[:2] != (1, 1) or min(output.shape) < 1:
        raise CheckpointError(f"{model}: gives {output.shape} instead of one mask; import a U2-Net or an IS-Net")
    mask = torch.from_numpy(output).float()
    low, high = mask.min(), mask.max()
    if not float(high - low) >= _NO_CONTRAST:  # So is what is not a number.
        raise Unsure("the matting model finds no object")
    return _cleaned(interpolate((mask - low) / (high - low), image.shape[1:], mode="bilinear", antialias=True)[0, 0])


@functools.lru_cache(maxsize=1)
def _rembg_session(name: str) -> Any:
    import rembg

    return rembg.new_session(name)


def _cleaned(alpha: Tensor) -> Tensor:
    """`alpha` (H, W) without the tiny parts; soft edges stay."""
    opaque = alpha > 0.5
    return alpha * ~(opaque & ~without_specks(opaque))
