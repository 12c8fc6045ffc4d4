"""The part of a network that looks at pictures: run at every step, or once for each sample.

Once is several times faster, and what the field's side learns from (volume, reader, decoder) is mostly how many objects
it has seen. The view's side (encoder, feature pyramid, planes) then stays as it is.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from arm_blender.errors import ArmError
from arm_blender.graphics.visual_hull import Outlines
from arm_blender.models.network_views import NetworkViews
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import EncodedViews
from arm_blender.models.small.pixel_aligned import ViewFeatures

from ..datasets.outline_samples import HULL_SIDE
from ..datasets.point_samples import PointSample, expanded

Network = GeoRM | GlossyRM

VIEW_SIDE = ("encoder", "pyramid", "transformer", "upsampler", "start")
"""Modules of a `ReconstructionModel`."""


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
    Without `features` image features are left out as well, and what remains is geometry and colours.
    """

    pictures = False

    def __init__(self, network: Network, load: Callable[[Path], PointSample], features: bool = True) -> None:
        self.network, self._load, self._features = network, load, features
        for name in VIEW_SIDE:
            freeze(network.model, name)
        if features:
            silence_planes(network)
        else:
            silence_features(network)

    @torch.no_grad()
    def load(self, path: Path) -> PointSample:
        """A sample whose images are features, colours if they are compared, and last the predicted depth."""
        sample = self._load(path)
        features = self.network.model.look(expanded(sample.views))[1]
        parts = [features.maps if self._features else torch.zeros_like(features.maps), features.depth]
        if features.colors is not None:
            size = features.maps.shape[-2:]
            parts.insert(1, F.interpolate(features.colors.flatten(0, 1), size=size).unflatten(0, parts[0].shape[:2]))
        return replace(sample, views=replace(sample.views, images=torch.cat(parts, dim=2).half()))

    def encode(self, network: Network, views: NetworkViews) -> EncodedViews:
        """As `EveryStep.encode`."""
        channels = network.config.pixel_aligned.channels
        maps, colors, depth = views.images.float().tensor_split((channels, views.images.shape[2] - 1), dim=2)
        outlines = Outlines(views.silhouette.float(), views.c2w, views.K)
        own = None
        if colors.shape[2]:
            side = network.config.volume.color_side(network.config.encoder.image_size)
            own = F.adaptive_avg_pool2d(colors.flatten(0, 1), side).unflatten(0, colors.shape[:2])
        return without_planes(network, ViewFeatures(maps, depth, outlines, own))


def encode_outlines(network: Network, outlines: Outlines, colors: Tensor | None) -> EncodedViews:
    """What outlines and colours tell without a network: no image features (zero is their mean), the hull for a depth.

    Args:
        colors: (B, V, 4, h, w) as in `ViewFeatures`.
    """
    depth = outlines.hull_depth(HULL_SIDE)[:, :, 1:]
    maps = depth.new_zeros(*depth.shape[:2], network.config.pixel_aligned.channels, 1, 1)
    maps = maps.expand(-1, -1, -1, HULL_SIDE, HULL_SIDE)
    return without_planes(network, ViewFeatures(maps, depth, outlines, colors))


def without_planes(network: Network, features: ViewFeatures) -> EncodedViews:
    """The field's side of an encoding."""
    planes = features.depth.new_zeros(len(features.depth), 3, network.config.upsampler.channels, 2, 2)
    volume = network.model.volume(features)
    return EncodedViews(planes, features, volume, network.model.refined(features, volume))


@torch.no_grad()
def silence_planes(network: Network) -> None:
    """Cut the decoder off from the planes."""
    network.model.decoder[0].weight[:, : 3 * network.config.upsampler.channels] = 0.0


@torch.no_grad()
def silence_features(network: Network) -> None:
    """Cut volume, reader and decoder off from the planes and from image features, and leave the hull's depth as it is.

    Without this, what was not learnt would have a say.
    """
    silence_planes(network)
    model, config = network.model, network.config.pixel_aligned
    model.pyramid.to_depth[-1].weight.zero_()
    model.pyramid.to_depth[-1].bias.zero_()
    model.volume.lift.weight[:, : 2 * config.channels] = 0.0
    model.reader.per_view[0].weight[:, : config.channels] = 0.0
    spread = 3 * network.config.upsampler.channels + 2 * config.hidden  # After the planes, the mean and the maximum.
    model.decoder[0].weight[:, spread : spread + config.channels] = 0.0


def view_side(network: Network, load: Callable[[Path], PointSample], args: argparse.Namespace) -> EveryStep | Once:
    """How a stage looks at pictures, as its arguments say, with the parts named there kept as they are."""
    for name in args.freeze:
        freeze(network.model, name)
    if args.look_once or args.no_features:
        return Once(network, load, not args.no_features)
    return EveryStep(load)


def freeze(model: nn.Module, name: str) -> None:
    """Keep the parameters of one part of `model` as they are.

    Raises:
        ArmError: it has no such part.
    """
    parts = dict(model.named_children())
    if name not in parts:
        raise ArmError(f"--freeze {name}: unknown; choose among {', '.join(parts)}")
    parts[name].requires_grad_(False)
