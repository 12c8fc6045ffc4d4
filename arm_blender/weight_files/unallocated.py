"""Networks without memory: built on the meta device, for weights that a file brings or that are only counted."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch.overrides import TorchFunctionMode


class _Uninitialised(TorchFunctionMode):
    """`torch.nn.init` does nothing."""

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        kwargs = kwargs or {}
        if getattr(func, "__module__", "") == "torch.nn.init":
            return args[0] if args else kwargs["tensor"]
        return func(*args, **kwargs)


@contextmanager
def unallocated() -> Iterator[None]:
    """What is built here has shapes and no values.

    Initial values are not drawn either: on the meta device PyTorch imports its compiler to draw nothing, which takes
    longer (1.5 s) than everything else that a network of `small` needs to be read.
    """
    with torch.device("meta"), _Uninitialised():
        yield
