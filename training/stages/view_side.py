"""The part of a network that looks at pictures: run at every step, or once for each sample.

Once is several times faster, and what the field's side learns from (volume, reader, decoder) is mostly how many objects
it has seen. The view's side (encoder, feature pyramid, planes) then stays as it is.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import nn

from arm_blender.errors import ArmError
from arm_blender.models.georm import GeoRM
from arm_blender.models.glossyrm import GlossyRM
from arm_blender.models.pixel_aligned import ViewFeatures
from arm_blender.models.reconstruction import EncodedViews, NetworkViews
from arm_blender.models.visual_hull import Outlines

from ..datasets.point_samples import PointSample, expanded

Network = GeoRM | GlossyRM

VIEW_SIDE = ("encoder", "pyramid", "transformer", "upsampler", "start")
"""Modules of a `ReconstructionModel`."""

HULL_SIDE = 40
"""Pixels a side at which outlines alone are given a depth: what the network takes of a picture's hull."""


@dataclass(frozen=True)
class EveryStep:
    """Samples hold pictures, and the network looks at them anew at every step."""

    load: Callable[[Path], PointSample]
    pictures = True

    def encode(self, network: Network, views: NetworkViews) -> EncodedViews:
        """Everything that points are decoded from.

        Args:
            views: of a batch, augmented, or compact.
        """
        return network.encode(expanded(views) if views.images.dtype == torch.uint8 else views)


class Once:
    """Samples hold the features that `network` finds in the pictures when they are loaded.

    The planes are left out, as they would have to turn with the augmented object: the decoder is cut off from them.
    """

    pictures = False

    def __init__(self, network: Network, load: Callable[[Path], PointSample]) -> None:
        self.network, self._load = network, load
        for name in VIEW_SIDE:
            freeze(network.model, name)
        with torch.no_grad():
            network.model.decoder[0].weight[:, : 3 * network.config.upsampler.channels] = 0.0

    @torch.no_grad()
    def load(self, path: Path) -> PointSample:
        """A sample whose images are features, and last the predicted depth."""
        sample = self._load(path)
        features = self.network.model.look(expanded(sample.views))[1]
        images = torch.cat([features.maps, features.depth], dim=2).half()
        return replace(sample, views=replace(sample.views, images=images))

    def encode(self, network: Network, views: NetworkViews) -> EncodedViews:
        """As `EveryStep.encode`."""
        images = views.images.float()
        outlines = Outlines(views.silhouette.float(), views.c2w, views.K)
        return without_planes(network, ViewFeatures(images[:, :, :-1], images[:, :, -1:], outlines))


def encode_outlines(network: Network, outlines: Outlines) -> EncodedViews:
    """What outlines alone tell: no image features (zero is their mean), and the visual hull for a depth."""
    depth = outlines.hull_depth(HULL_SIDE)[:, :, 1:]
    maps = depth.new_zeros(*depth.shape[:2], network.config.pixel_aligned.channels, 1, 1)
    return without_planes(network, ViewFeatures(maps.expand(-1, -1, -1, HULL_SIDE, HULL_SIDE), depth, outlines))


def without_planes(network: Network, features: ViewFeatures) -> EncodedViews:
    """The field's side of an encoding."""
    planes = features.depth.new_zeros(len(features.depth), 3, network.config.upsampler.channels, 2, 2)
    return EncodedViews(planes, features, network.model.volume(features))


def view_side(network: Network, load: Callable[[Path], PointSample], once: bool, frozen: list[str]) -> EveryStep | Once:
    """How a stage looks at pictures, with the parts `frozen` of the network kept as they are."""
    for name in frozen:
        freeze(network.model, name)
    return Once(network, load) if once else EveryStep(load)


def freeze(model: nn.Module, name: str) -> None:
    """Keep the parameters of one part of `model` as they are.

    Raises:
        ArmError: it has no such part.
    """
    parts = dict(model.named_children())
    if name not in parts:
        raise ArmError(f"--freeze {name}: unknown; choose among {', '.join(parts)}")
    parts[name].requires_grad_(False)
