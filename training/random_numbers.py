"""Random numbers as plain floats."""

import torch


def uniform(generator: torch.Generator, low: float = 0.0, high: float = 1.0) -> float:
    """One number, evenly drawn from `low` to `high`."""
    return low + (high - low) * float(torch.rand((), generator=generator))
