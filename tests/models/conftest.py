"""Stored inputs, weights and outputs of public networks under random weights, and how close ours must come."""

from pathlib import Path
from typing import NamedTuple

import pytest
import torch
from safetensors.torch import load_file

FOLDER = Path(__file__).parents[1] / "data/parity"


class Parity(NamedTuple):
    """One network: its tensors under their own names."""

    weights: dict[str, torch.Tensor]
    inputs: dict[str, torch.Tensor]
    outputs: dict[str, torch.Tensor]

    def check(self, found: torch.Tensor, name: str) -> None:
        """`found` is the stored output `name`: to 1e-5 of its largest value."""
        found, expected = found.detach(), self.outputs[name]
        assert found.shape == expected.shape
        assert float((found - expected).abs().max()) <= 1e-5 * float(expected.abs().max())


@pytest.fixture(scope="session")
def parity():
    """Reads a fixture by its name."""

    def read(name: str) -> Parity:
        tensors = load_file(FOLDER / f"{name}.safetensors")
        return Parity(
            *(
                {key.removeprefix(prefix): tensor for key, tensor in tensors.items() if key.startswith(prefix)}
                for prefix in ("weights/", "input/", "output/")
            )
        )

    return read
