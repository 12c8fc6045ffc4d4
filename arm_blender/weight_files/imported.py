"""Weights of other projects, brought by the user: read without running code, renamed, checked, written as ours."""

import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from ..errors import CheckpointError
from ..machine.files import check_output
from ..models.image_encoder import ImageEncoder, ImageEncoderConfig
from ..models.material_encoder import MaterialEncoder, MaterialEncoderConfig
from ..models.paper.georm import GeoRM
from ..models.paper.reconstruction import INSTANTMESH, ReconstructionConfig
from ..models.triplane import Upsampler
from . import checkpoints, key_maps
from .unallocated import unallocated

DINO_LICENCE = "Apache-2.0"
INSTANTMESH_LICENCE = "CC-BY-NC-4.0 (published as Apache-2.0, but trained from OpenLRM's weights)"
MATERIALISTIC_LICENCE = "all rights reserved (published without a licence)"


LPIPS_LICENCE = "BSD-3-Clause AND BSD-2-Clause"

_VGG_LAYERS = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28))
"""The convolutions of VGG-16 by their places in its sequence, in LPIPS's five stages."""

_SCALING = {"shift": (-0.030, -0.088, -0.188), "scale": (0.458, 0.448, 0.450)}
"""LPIPS's normalisation of images in [-1, 1], version 0.1; the file of its heads has it not."""


@dataclass(frozen=True)
class LpipsConfig:
    """Of the network that LPIPS compares features of."""

    channels: tuple[int, ...] = (64, 128, 256, 512, 512)
    """Of its five stages."""


@dataclass(frozen=True)
class Converted:
    """A network of ours with the weights of another project.

    Attributes:
        config: that the weights fit; goes into the file.
        state: every tensor of the network, those that the other project has not as they are before training.
        origin: whose weights they are.
        licence: of the weights.
    """

    config: Any
    state: dict[str, Tensor]
    origin: str
    licence: str


def import_weights(source: Path, kind: str, output: Path | None = None, *rest: Path) -> tuple[Path, Converted]:
    """Convert a published checkpoint into a file of ours, with its source, SHA-256 and licence in the header.

    Args:
        source: a PyTorch or safetensors file.
        kind: a key of `KINDS`.
        rest: further files, where the weights are published in several.
        output: None puts it where the preset that uses it looks, and records its hash.
    Returns:
        the file written, and what is in it.
    Raises:
        CheckpointError: the file is missing, damaged, holds code, or is not the network asked for.
        OutputError: the result cannot be written.
    """
    registered, convert = KINDS[kind]
    path = output or checkpoints.shipped(registered)
    check_output(path.parent)
    sources = (source, *rest)
    converted = convert({key: t for file in sources for key, t in read_tensors(file).items()}, str(source))
    metadata = {
        "source": " ".join(file.name for file in sources),
        "source_sha256": " ".join(checkpoints.sha256(file) for file in sources),
        "origin": converted.origin,
        "licence": converted.licence,
    }
    try:
        checkpoints.save(path, converted.state, converted.config, registered, metadata)
    except ValueError as error:
        raise CheckpointError(f"{source}: damaged ({error}); download it again") from error
    if output is None:
        checkpoints.record(path)
    return path, converted


def read_tensors(path: Path) -> dict[str, Tensor]:
    """The tensors of a foreign checkpoint; nothing that a file may hold besides is ever run.

    Raises:
        CheckpointError: the file is missing, damaged, or holds more than tensors.
    """
    if not path.is_file():
        what = "is a folder, give the file of weights in it" if path.is_dir() else "no such file, check the path"
        raise CheckpointError(f"{path}: {what}")
    try:
        with safe_open(path, framework="pt") as file:
            if (file.metadata() or {}).get("format") == checkpoints.FORMAT:
                raise CheckpointError(f"{path}: was written by this program; there is nothing to import")
            return checkpoints.tensors_in(file, path)
    except (SafetensorError, OSError) as error:
        if path.suffix == ".safetensors":
            raise CheckpointError(f"{path}: damaged ({error}); download it again") from error
    try:
        # Only the newer format, a zip archive, can be mapped instead of read.
        found = torch.load(path, map_location="cpu", weights_only=True, mmap=zipfile.is_zipfile(path))
        # torch's unpickler raises whatever damaged bytes make it stumble over.
    except Exception as error:  # noqa: BLE001
        raise CheckpointError(
            f"{path}: damaged, or holds more than tensors, and code in a file is never run; "
            "download it again, or take it as safetensors"
        ) from error
    state = found.get("state_dict", found) if isinstance(found, dict) else found
    if not isinstance(state, dict) or not state or not all(isinstance(value, Tensor) for value in state.values()):
        raise CheckpointError(f"{path}: is no table of tensors; take the file that holds the weights alone")
    return state


def georm_from_instantmesh(
    state: dict[str, Tensor], name: str, config: ReconstructionConfig = INSTANTMESH
) -> Converted:
    """GeoRM from a checkpoint of InstantMesh, of either stage; layers and plane channels are read off it.

    Args:
        state: their tensors; those of its perceptual loss are left aside.
        name: of the file, for messages.
        config: what else the network is.
    Raises:
        CheckpointError: a key is missing, unmapped, or wrongly shaped.
    """
    theirs = {
        key.removeprefix("lrm_generator."): tensor for key, tensor in state.items() if not key.startswith("lpips.")
    }
    mesh = any(key.startswith("synthesizer.decoder.net_sdf.") for key in theirs)
    config = _sized(config, theirs)
    with unallocated():
        own = GeoRM(config).state_dict()
    ours = key_maps.convert(theirs, key_maps.instantmesh(config, mesh), own, name)
    # Only the super-resolution is not theirs; the other 1.5 GB need not be made first.
    upsampler = _fresh(lambda: Upsampler(config.upsampler, config.transformer.width))
    rest = {f"model.upsampler.{key}": tensor for key, tensor in upsampler.items()}
    stage = "mesh" if mesh else "volume"
    return Converted(config, rest | ours, f"InstantMesh, {stage} model", INSTANTMESH_LICENCE)


def image_encoder_from_dino(state: dict[str, Tensor], name: str, config: ImageEncoderConfig | None = None) -> Converted:
    """The image encoder from a DINO ViT, under the names of its repository or of the transformers library.

    Its camera layers are new, and do nothing before they are trained.

    Raises:
        CheckpointError: a key is missing, unmapped, or wrongly shaped.
    """
    config = config or ImageEncoderConfig()
    own = _fresh(lambda: ImageEncoder(config))
    ours = key_maps.convert(state, key_maps.image_encoder(_dino(state, config.depth)), own, name)
    return Converted(config, own | ours, "DINO", DINO_LICENCE)


def material_encoder_from_dino(
    state: dict[str, Tensor], name: str, config: MaterialEncoderConfig | None = None
) -> Converted:
    """The material encoder from a DINO ViT, as `image_encoder_from_dino`, or from Materialistic with its cascade.

    What the file lacks, the cascade or its last convolution, is new.

    Raises:
        CheckpointError: a key is missing, unmapped, or wrongly shaped.
    """
    config = config or MaterialEncoderConfig()
    own = _fresh(lambda: MaterialEncoder(config))
    theirs = {key.removeprefix("net."): tensor for key, tensor in state.items()}
    if any(key.startswith("dino_model.") for key in theirs):
        vit = key_maps.material_vit(key_maps.hub_vit(config.vit.depth, "dino_model."))
        ours = key_maps.convert(theirs, vit | key_maps.materialistic_cascade(), own, name)
        return Converted(config, own | ours, "Materialistic", MATERIALISTIC_LICENCE)
    ours = key_maps.convert(state, key_maps.material_vit(_dino(state, config.vit.depth)), own, name)
    return Converted(config, own | ours, "DINO", DINO_LICENCE)


def lpips_from_vgg(state: dict[str, Tensor], name: str, config: LpipsConfig | None = None) -> Converted:
    """LPIPS over VGG-16 (Zhang et al. 2018) from torchvision's network and the published heads, or from the package's
    own state dict.

    Raises:
        CheckpointError: a key is missing, unmapped, or wrongly shaped.
    """
    config = config or LpipsConfig()
    own, sources, depth = {}, {}, 3
    for stage, (layers, channels) in enumerate(zip(_VGG_LAYERS, config.channels, strict=True)):
        for layer in layers:
            for part, shape in (("weight", (channels, depth, 3, 3)), ("bias", (channels,))):
                key = f"net.slice{stage + 1}.{layer}.{part}"
                own[key] = torch.empty(shape, device="meta")
                theirs = f"features.{layer}.{part}"
                sources[key] = key_maps.Source((theirs if theirs in state else key,), lambda tensor: tensor)
            depth = channels
        key = f"lin{stage}.model.1.weight"
        own[key] = torch.empty((1, channels, 1, 1), device="meta")
        sources[key] = key_maps.Source((key,), lambda tensor: tensor)
    for key, value in _SCALING.items():
        key, scaling = f"scaling_layer.{key}", torch.tensor(value)[None, :, None, None]
        own[key] = scaling
        state = {key: scaling} | state
        sources[key] = key_maps.Source((key,), lambda tensor: tensor)
    ours = key_maps.convert(state, key_maps.KeyMap(sources, ("classifier.", "lins.")), own, name)
    return Converted(config, ours, "LPIPS over VGG-16", LPIPS_LICENCE)


KINDS: dict[str, tuple[str, Callable[[dict[str, Tensor], str], Converted]]] = {
    "georm": ("instantmesh.georm", georm_from_instantmesh),
    "image-encoder": ("paper.image_encoder", image_encoder_from_dino),
    "material-encoder": ("paper.material_encoder", material_encoder_from_dino),
    "lpips": ("lpips.vgg", lpips_from_vgg),
}
"""What can be imported: the name under which it is registered, and how."""


def _dino(state: dict[str, Tensor], depth: int) -> key_maps.KeyMap:
    return key_maps.hub_vit(depth) if "pos_embed" in state else key_maps.transformers_vit(depth)


def _sized(config: ReconstructionConfig, theirs: dict[str, Tensor]) -> ReconstructionConfig:
    """`config` with as many layers and plane channels as the checkpoint has: InstantMesh comes in two sizes."""
    beginning = "transformer.layers."
    layers = {key.removeprefix(beginning).partition(".")[0] for key in theirs if key.startswith(beginning)}
    deconvolution = theirs.get("transformer.deconv.weight")
    if layers:
        config = replace(config, transformer=replace(config.transformer, layers=len(layers)))
    if deconvolution is not None and deconvolution.ndim == 4:
        config = replace(config, upsampler=replace(config.upsampler, channels=deconvolution.shape[1]))
    return config


def _fresh(build: Callable[[], nn.Module]) -> dict[str, Tensor]:
    """The state of a network before training, the same each time; the caller's random numbers stay untouched."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return build().state_dict()
