"""The networks of a run: found, given their weights, and kept for the next item of a batch or dropped after use.

A network is built without memory (on the meta device) and takes over the tensors of its file, which are mapped, not
read: nothing is there twice. Large ones are not kept, so that a run's peak is its largest network, not their sum.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import nn

from .config import PRESETS, Settings
from .errors import CheckpointError
from .machine.interruptible import interruptible
from .machine.precision import chosen, running_in
from .models.atlas_network import AtlasNetworkConfig
from .models.paper.georm import GeoRM
from .models.paper.glossyrm import GlossyRM
from .models.paper.instant_albedo import PaperInstantAlbedo
from .models.paper.reconstruction import ReconstructionConfig
from .models.random_weights import random_state
from .models.small.finish import Finish, FinishConfig
from .models.small.instant_albedo import InstantAlbedo, InstantAlbedoConfig
from .models.small.ray_occupancy import RayOccupancy, RayOccupancyConfig
from .models.small.volume_georm import VolumeGeoRM, VolumeGeoRMConfig
from .report import Report
from .weight_files import checkpoints
from .weight_files.unallocated import unallocated

NETWORKS: dict[str, dict[type, Callable[[Any], nn.Module]]] = {
    "georm": {VolumeGeoRMConfig: VolumeGeoRM, ReconstructionConfig: GeoRM},
    "glossyrm": {ReconstructionConfig: GlossyRM},
    "finish": {FinishConfig: Finish},
    "instant_albedo": {InstantAlbedoConfig: InstantAlbedo, AtlasNetworkConfig: PaperInstantAlbedo},
    "ray_occupancy": {RayOccupancyConfig: RayOccupancy},
}
"""What makes each network, by the type of the config that its checkpoint carries."""

LARGE = 2**25
"""Parameters from which on a network is read anew for each item of a batch, and may run in bfloat16. The largest of
`small` has 3 million, the smallest of `paper` 120 million."""

_KEPT_AT_MOST = 4

_kept: dict[tuple[str, Path, int, str], nn.Module] = {}


def needed(settings: Settings, views: int, given_shape: bool = False) -> tuple[str, ...]:
    """Names of the networks that a run from so many views is going to need; a given shape needs none to be made."""
    preset = PRESETS[settings.preset]
    shape = () if given_shape else (preset.shape_network(views),)
    return (*shape, preset.gloss_network, "instant_albedo")


def check_weights(settings: Settings, report: Report, names: Iterable[str]) -> None:
    """That the files of the networks of those names are there, and under which licence.

    Raises:
        CheckpointError: one is missing or none of ours, or as `check_folder`.
    """
    if settings.random_weights is not None:
        return
    check_folder(settings)
    known = {weights.name: weights.licence for weights in checkpoints.REGISTRY}
    for name in names:
        header = checkpoints.read_header(settings.weights(name))
        licence = header.get("licence") or known.get(header["name"], "your own")
        report.weights[header["name"]] = "your own" if settings.brings(name) else licence


def check_folder(settings: Settings) -> None:
    """That the user's folder of weights, where one is named, holds weights of a network of the preset.

    Raises:
        CheckpointError: it is none, or holds nothing of the right names; what ships would be taken in silence.
    """
    folder = settings.weights_folder
    if folder is None or any(map(settings.brings, settings.networks)):
        return
    names = ", ".join(settings.weights(network).name for network in settings.networks)
    if not folder.is_dir():
        raise CheckpointError(f"{folder}: no such folder; name one that holds {names}, or some of them")
    raise CheckpointError(f"{folder}: holds none of {names}; name the trained files so")


def build(name: str, config: Any) -> nn.Module:
    """The network of that name that the config is of; its weights are random."""
    return NETWORKS[name][type(config)](config)


def read(name: str, path: Path) -> nn.Module:
    """The network of that name that a file holds, of whatever preset.

    Raises:
        CheckpointError: as `checkpoints.load`.
    """
    config: Any
    config, state = checkpoints.load(path, *NETWORKS[name])
    with unallocated():
        module = build(name, config)
    checkpoints.restore(module, state, path)
    return module


def load(name: str, settings: Settings) -> nn.Module:
    """A network with its weights, ready to run; the caller holds the only reference to a large one.

    Args:
        name: of one of the preset's networks.
        settings: whose preset, device and random weights count.
    Raises:
        CheckpointError: the weights are missing, damaged, or made for another model.
    """
    if settings.random_weights is not None:
        return _ready(_with_random_weights(name, settings, settings.random_weights), settings.device)
    path = settings.weights(name)
    # Weights that are trained anew under the same name are read anew.
    key = (name, path, path.stat().st_mtime_ns if path.is_file() else 0, settings.device)
    if key in _kept:
        return _kept[key]
    module = _ready(read(name, path), settings.device)
    if not is_large(module):
        while len(_kept) >= _KEPT_AT_MOST:
            del _kept[next(iter(_kept))]
        _kept[key] = module
    return module


@contextmanager
def running(module: nn.Module, settings: Settings, report: Report, check: Callable[[], None]) -> Iterator[None]:
    """A network at work: in the precision that suits it, which the report names where it is not float32.

    Args:
        check: called before every layer of the network; what it raises ends the pass there.
    """
    dtype = chosen(settings.precision, settings.device, is_large(module))
    if dtype != torch.float32:
        why = f"{settings.device} multiplies bfloat16 faster; --precision float32 keeps it"
        report.leave_out(f"float32 in {type(module).__name__}", why if settings.precision == "auto" else "as asked for")
    with running_in(dtype, settings.device), interruptible((module,), check):
        yield


def is_large(module: nn.Module) -> bool:
    """Whether a network has `LARGE` parameters or more."""
    return sum(parameter.numel() for parameter in module.parameters()) >= LARGE


def _with_random_weights(name: str, settings: Settings, seed: int) -> nn.Module:
    preset = PRESETS[settings.preset]
    with unallocated():
        module = build(name, getattr(preset, name))
    # One seed for all: GlossyRM begins with GeoRM's weights, as its training does.
    module.load_state_dict(random_state(module, seed), assign=True)
    return module


def _ready(module: nn.Module, device: str) -> nn.Module:
    return module.to(device).eval().requires_grad_(False)
