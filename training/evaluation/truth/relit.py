"""What objects are relit under, and the true pictures of it on disk."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from arm_blender.errors import ArmError

from ...rendering import shards


def relit_lights(others: Sequence[Path], own: Sequence[Path], first: Path, count: int) -> list[Path]:
    """The environments that one object is relit under, the same in every run.

    Args:
        others: those of split eval, which come first.
        own: Blender's, taken evenly in their order for what is missing.
        first: the light of the inputs, which is not taken.
        count: of environments.
    Raises:
        ArmError: there are not so many.
    """
    found = [light for light in others if light != first][:count]
    rest = [light for light in own if light != first and light not in found]
    missing = count - len(found)
    if missing > len(rest):
        raise ArmError(f"{len(found) + len(rest)} environments, {count} are needed; name more in the manifest's hdris")
    return found + [rest[k * len(rest) // missing] for k in range(missing)]


def relit_pictures(path: Path) -> tuple[Tensor, Tensor]:
    """The true pictures of a file of `Relighting`: (V, 3, N, N) sRGB, and (V, 1, N, N) coverage, in [0, 1].

    Raises:
        ArmError: it is missing or damaged.
    """
    rgba = torch.from_numpy(shards.arrays(path, "rgba")["rgba"]).permute(0, 3, 1, 2).float() / 255.0
    return rgba[:, :3], rgba[:, 3:]


def save_relit(path: Path, pictures: Sequence[NDArray[np.uint8]]) -> None:
    """Write pictures (N, N, 4) uint8, sRGB with coverage, under one light, for `relit_pictures`."""
    shards.save_arrays(path, {"rgba": np.stack(pictures)})
