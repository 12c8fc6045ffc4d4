"""In which precision networks run: float32, or bfloat16 by autocast where the device gains from it.

bfloat16 has the range of float32 and 8 bits of mantissa: nothing overflows, and a rounding costs up to 0.4 %.
Transforms, the decoding of points and all shading stay in float32.
"""

from contextlib import AbstractContextManager, nullcontext

import torch

from ..knobs import PrecisionName


def gains_from_bfloat16(device: str) -> bool:
    """Whether a device multiplies bfloat16 in hardware: CPUs with AVX512-BF16 or AMX, CUDA from Ampere on.

    On other CPUs it is emulated and slower than float32. Apple's devices stay in float32: theirs was not measured.
    """
    if device == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    # Not in every version of torch, hence the care; without an answer float32 is right everywhere.
    asked = (getattr(torch.cpu, f"_is_{name}_supported", None) for name in ("avx512_bf16", "amx_tile"))
    return device == "cpu" and any(supported() for supported in asked if supported is not None)


def chosen(precision: PrecisionName, device: str, large: bool) -> torch.dtype:
    """What a network's matrix products and convolutions run in.

    Args:
        precision: what the user asks for. "auto" takes bfloat16 for large networks where the device gains from it: in
            small ones it saves no time worth a difference.
        device: cpu, cuda or mps.
        large: whether the network is.
    """
    if precision == "auto":
        return torch.bfloat16 if large and gains_from_bfloat16(device) else torch.float32
    return getattr(torch, precision)


def running_in(dtype: torch.dtype, device: str) -> AbstractContextManager[object]:
    """A context in which networks with float32 weights run in `dtype`."""
    # Not every device and version of torch knows autocast, not even one that is switched off.
    return nullcontext() if dtype == torch.float32 else torch.autocast(device, dtype=dtype)
