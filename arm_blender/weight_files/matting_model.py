"""A matting network as the user brings it: an ONNX file, opened by onnxruntime and refused where it is of no use."""

import functools
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import CheckpointError

MATTING = "matting"
"""The name under which a model is registered, and its kind: it is taken as it is."""

SIDES = (320, 1024)
"""Pixels a side of the input of the networks that are known: U2-Net, IS-Net."""


def check_model(model: Path) -> None:
    """Raises `CheckpointError` where a file is missing, damaged, no U2-Net or IS-Net, or onnxruntime is."""
    if not model.is_file():
        raise CheckpointError(f"{model}: no such file, check the path")
    if find_spec("onnxruntime") is None:
        raise CheckpointError(f"{model}: onnxruntime is not installed; pip install onnxruntime, and import it again")
    opened(model)


def opened(model: Path, threads: int = 0) -> tuple[Any, int]:
    """The network, ready to run, and the pixels a side of its input, one of `SIDES`.

    Args:
        threads: of the processor; 0 leaves them to onnxruntime.
    Raises:
        CheckpointError: the file is damaged, or no U2-Net or IS-Net.
    """
    return _session(model, model.stat().st_mtime_ns, threads)


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
    except failures() as error:
        raise CheckpointError(f"{model}: no readable ONNX model ({error}); download it again") from error
    inputs = session.get_inputs()
    shape = inputs[0].shape if inputs else []
    if len(inputs) != 1 or len(shape) != 4 or shape[1] != 3 or shape[2] != shape[3] or shape[2] not in SIDES:
        raise CheckpointError(
            f"{model}: takes {[entry.shape for entry in inputs]}; "
            "import a U2-Net (3x320x320) or an IS-Net (3x1024x1024)"
        )
    return session, shape[2]


def failures() -> tuple[type[Exception], ...]:
    """What onnxruntime raises; its exceptions have no base of their own."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    return tuple(kind for kind in vars(state).values() if isinstance(kind, type) and issubclass(kind, Exception))
