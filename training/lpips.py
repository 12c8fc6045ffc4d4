"""LPIPS, the learned perceptual distance (Zhang et al. 2018, arXiv 1801.03924), for who has its weights.

The weights are the state dict of the public package's `LPIPS(net="vgg")`, or of `LPIPS(net="alex")`, as a safetensors
file: a network's convolutions and five heads. None ship with this project; `python -m arm_blender weights download
lpips.vgg` gets those of VGG. The paper trains with VGG and reports Alex.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor
from torch.nn import functional

from arm_blender.errors import CheckpointError


@dataclass(frozen=True)
class _Trunk:
    """A network whose features are compared: convolutions in stages, with a pooling before some of these.

    Attributes:
        stages: of each stage the convolutions: place in the network's sequence, stride, padding.
        pooled: the stages, counted from 0, with a maximum before them.
        window: of the maximum; its stride is 2.
    """

    stages: tuple[tuple[tuple[int, int, int], ...], ...]
    pooled: tuple[int, ...]
    window: int


_TRUNKS = (
    _Trunk(  # VGG-16
        tuple(tuple((i, 1, 1) for i in s) for s in ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28))),
        pooled=(1, 2, 3, 4),
        window=2,
    ),
    _Trunk((((0, 4, 2),), ((3, 1, 2),), ((6, 1, 1),), ((8, 1, 1),), ((10, 1, 1),)), pooled=(1, 2), window=3),  # AlexNet
)

_TINY = 1e-10
"""Inside the square root: a pixel without any feature has a zero gradient instead of none."""


class Lpips:
    """Distance of two batches of images, differentiable in both."""

    def __init__(self, state: dict[str, Tensor]) -> None:
        """Raises KeyError where a weight is missing."""
        self.trunk = next((t for t in _TRUNKS if f"net.slice5.{t.stages[4][0][0]}.weight" in state), _TRUNKS[0])
        self.convolutions = [
            [(state[f"net.slice{k}.{i}.weight"], state[f"net.slice{k}.{i}.bias"], step, pad) for i, step, pad in stage]
            for k, stage in enumerate(self.trunk.stages, start=1)
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
                f"{path}: no LPIPS weights ({error}); get them by `python -m arm_blender weights download lpips.vgg`, "
                "or save the state dict of lpips.LPIPS(net='vgg') as safetensors"
            ) from error

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        """Mean distance over the pairs, a scalar >= 0.

        Args:
            x: (V, 3, H, W) sRGB in [0, 1], at least 32 pixels a side.
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
            if stage in self.trunk.pooled:
                x = functional.max_pool2d(x, self.trunk.window, stride=2)
            for weight, bias, stride, padding in convolutions:
                x = functional.relu(functional.conv2d(x, weight.to(x), bias.to(x), stride, padding))
            maps.append(x / torch.sqrt(x.square().sum(dim=1, keepdim=True) + _TINY))
        return maps
