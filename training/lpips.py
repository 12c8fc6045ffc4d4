"""LPIPS, the learned perceptual distance (Zhang et al. 2018, arXiv 1801.03924), for who has its weights.

The weights are the state dict of the public package's `LPIPS(net="vgg")` as a safetensors file: VGG-16's convolutions
and five heads. None ship with this project.
"""

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor
from torch.nn import functional

from arm_blender.errors import CheckpointError

_STAGES = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28))
"""Places of VGG-16's convolutions in its sequence; a pooling stands before every stage but the first."""

_TINY = 1e-10
"""Inside the square root: a pixel without any feature has a zero gradient instead of none."""


class Lpips:
    """Distance of two batches of images, differentiable in both."""

    def __init__(self, state: dict[str, Tensor]) -> None:
        """Raises KeyError where a weight is missing."""
        self.convolutions = [
            [(state[f"net.slice{k}.{i}.weight"], state[f"net.slice{k}.{i}.bias"]) for i in places]
            for k, places in enumerate(_STAGES, start=1)
        ]
        self.heads = [state[f"lin{k}.model.1.weight"] for k in range(5)]
        self.shift, self.scale = state["scaling_layer.shift"], state["scaling_layer.scale"]

    @classmethod
    def from_file(cls, path: Path) -> "Lpips":
        """Raises CheckpointError where the file is missing, damaged, or holds something else."""
        try:
            return cls(load_file(path))
        except (OSError, SafetensorError, KeyError) as error:
            raise CheckpointError(
                f"{path}: no LPIPS weights ({error}); save the state dict of lpips.LPIPS(net='vgg') as safetensors"
            ) from error

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        """Mean distance over the pairs, a scalar >= 0.

        Args:
            x: (V, 3, H, W) sRGB in [0, 1], at least 16 pixels a side.
            y: the same shape.
        """
        distance = x.new_zeros(())
        for a, b, head in zip(self._features(x), self._features(y), self.heads, strict=True):
            distance = distance + functional.conv2d((a - b).square(), head.to(x)).mean()
        return distance

    def _features(self, images: Tensor) -> list[Tensor]:
        """Five maps, of unit length over the channels."""
        x = (2.0 * images - 1.0 - self.shift.to(images)) / self.scale.to(images)
        maps = []
        for stage, convolutions in enumerate(self.convolutions):
            if stage:
                x = functional.max_pool2d(x, 2)
            for weight, bias in convolutions:
                x = functional.relu(functional.conv2d(x, weight.to(x), bias.to(x), padding=1))
            maps.append(x / torch.sqrt(x.square().sum(dim=1, keepdim=True) + _TINY))
        return maps
