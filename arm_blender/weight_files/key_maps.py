"""Which tensor of a published checkpoint becomes which of ours.

A map is complete in both directions: a tensor of theirs that it neither uses nor names as unused is an error, and so
is one that it needs and does not find. Where several of theirs make one of ours, or one makes several, the source says
how.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import CheckpointError
from ..models.paper.georm import RAW_ISO
from ..models.paper.reconstruction import ReconstructionConfig


@dataclass(frozen=True)
class Source:
    """Where a tensor of ours comes from.

    Attributes:
        keys: of theirs.
        take: makes ours from theirs, in the order of the keys.
    """

    keys: tuple[str, ...]
    take: Callable[..., Tensor]


@dataclass(frozen=True)
class KeyMap:
    """All tensors that a checkpoint gives us.

    Attributes:
        sources: by our key.
        unused: beginnings of their keys for which we have no place.
    """

    sources: dict[str, Source]
    unused: tuple[str, ...] = ()

    def renamed(self, prefix: str, names: Mapping[str, str]) -> "KeyMap":
        """Our keys with the parts `names` replaced and `prefix` in front."""
        sources: dict[str, Source] = {}
        for key, source in self.sources.items():
            for old, new in names.items():
                key = key.replace(old, new)
            sources[prefix + key] = source
        return KeyMap(sources, self.unused)

    def __or__(self, other: "KeyMap") -> "KeyMap":
        return KeyMap(self.sources | other.sources, self.unused + other.unused)


def convert(state: Mapping[str, Tensor], key_map: KeyMap, own: Mapping[str, Tensor], name: str) -> dict[str, Tensor]:
    """Our tensors from theirs; those of `own` that the map does not name are left to the caller.

    Args:
        state: their tensors.
        own: the state dict of our module, of which the shapes count; it may lie on the meta device.
        name: of the file, for the message.
    Raises:
        CheckpointError: a key is missing, unmapped, or wrongly shaped.
    """
    used = {key for source in key_map.sources.values() for key in source.keys}
    problems = [f"{key} is missing" for key in used - state.keys()]
    problems += [
        f"{key} is unknown" for key in state.keys() - used if not (key_map.unused and key.startswith(key_map.unused))
    ]
    ours = {}
    for key, source in key_map.sources.items():
        if not state.keys() >= set(source.keys):
            continue
        theirs = [state[k] for k in source.keys]
        shapes = " + ".join(f"{k} {tuple(t.shape)}" for k, t in zip(source.keys, theirs, strict=True))
        try:
            ours[key] = source.take(*theirs)
        except (RuntimeError, IndexError, ValueError):
            problems.append(f"{shapes} do not fit together")
            continue
        if ours[key].shape != own[key].shape:
            problems.append(f"{shapes} gives {tuple(ours[key].shape)} instead of {tuple(own[key].shape)}")
    if problems:
        problems.sort()
        more = f" and {len(problems) - 3} more" if len(problems) > 3 else ""
        raise CheckpointError(f"{name}: {'; '.join(problems[:3])}{more}; get the published file of this network")
    return ours


def hub_vit(depth: int, prefix: str = "") -> KeyMap:
    """DINO's ViT under the names of its own repository, which are `VisionTransformer`'s, and `norm`."""
    ours = ["cls_token", "pos_embed", *_pair("patch_embed.proj"), *_pair("norm")]
    for i in range(depth):
        for part in ("norm1", "attn.qkv", "attn.proj", "norm2", "mlp.fc1", "mlp.fc2"):
            ours += _pair(f"blocks.{i}.{part}")
    return KeyMap({key: _same(prefix + key) for key in ours})


def transformers_vit(depth: int, prefix: str = "") -> KeyMap:
    """As `hub_vit`, from the names of the transformers library; its pooler has no place."""
    sources = {
        "cls_token": _same(f"{prefix}embeddings.cls_token"),
        "pos_embed": _same(f"{prefix}embeddings.position_embeddings"),
    }
    sources |= _layer("patch_embed.proj", f"{prefix}embeddings.patch_embeddings.projection")
    sources |= _layer("norm", f"{prefix}layernorm")
    for i in range(depth):
        ours, theirs = f"blocks.{i}", f"{prefix}encoder.layer.{i}"
        for part in ("weight", "bias"):
            parts = tuple(f"{theirs}.attention.attention.{name}.{part}" for name in ("query", "key", "value"))
            sources[f"{ours}.attn.qkv.{part}"] = Source(parts, lambda *tensors: torch.cat(tensors))
        sources |= _layer(f"{ours}.norm1", f"{theirs}.layernorm_before")
        sources |= _layer(f"{ours}.attn.proj", f"{theirs}.attention.output.dense")
        sources |= _layer(f"{ours}.norm2", f"{theirs}.layernorm_after")
        sources |= _layer(f"{ours}.mlp.fc1", f"{theirs}.intermediate.dense")
        sources |= _layer(f"{ours}.mlp.fc2", f"{theirs}.output.dense")
    return KeyMap(sources, (f"{prefix}pooler.",))


def image_encoder(vit: KeyMap, prefix: str = "") -> KeyMap:
    """`ImageEncoder` from a ViT without cameras: its own camera layers are left as they are."""
    names = {"patch_embed.proj": "patch_embed", "pos_embed": "position", "mlp.fc1": "mlp.0", "mlp.fc2": "mlp.2"}
    return vit.renamed(prefix, names)


def material_vit(vit: KeyMap, prefix: str = "vit.") -> KeyMap:
    """`MaterialEncoder`'s transformer; it reads tokens before the last norm, which therefore has no place."""
    last = {key: source for key, source in vit.sources.items() if key.startswith("norm.")}
    kept = {prefix + key: source for key, source in vit.sources.items() if key not in last}
    return KeyMap(kept, vit.unused + tuple(key for source in last.values() for key in source.keys))


def materialistic_cascade() -> KeyMap:
    """The cascade of the public material encoder (its Lightning prefix `net.` taken off); the head stays to be learned.

    Dropping its cross-attention drops layer norms too, so the fusion meets shifted statistics: fine-tune.
    """
    sources: dict[str, Source] = {}
    unused = ["cross_attention_", "out_conv.", "fusion_4.resConfUnit1."]
    for k in range(4):
        theirs, ours = f"fusion_{k + 1}", f"fusions.{k}"  # They count from one.
        sources |= _layer(f"contexts.{k}.readout", f"spatial_transform_{k + 1}.0.project.0")
        sources |= _layer(f"contexts.{k}.conv", f"spatial_transform_{k + 1}.2")
        sources |= _layer(f"{ours}.out", f"{theirs}.out_conv")
        for unit, name in (("join", "resConfUnit1"), ("refine", "resConfUnit2")):
            if k < 3 or unit == "refine":  # The deepest fusion has nothing to join.
                sources |= _layer(f"{ours}.{unit}.conv1", f"{theirs}.{name}.conv1")
                sources[f"{ours}.{unit}.conv2.weight"] = _same(f"{theirs}.{name}.conv2.weight")
        unused.append(f"{theirs}.layer_norm_1.")
    return KeyMap(sources, tuple(unused))


def camera_encoder(depth: int, prefix: str = "") -> KeyMap:
    """`ImageEncoder` from InstantMesh's, cameras included."""
    key_map = image_encoder(transformers_vit(depth, f"{prefix}model."))
    sources: dict[str, Source] = {}
    for layer in (0, 2):
        sources |= _layer(f"camera_embedder.{layer}", f"{prefix}camera_embedder.{layer}")
    for i in range(depth):
        sources |= _layer(f"blocks.{i}.modulation.1", f"{prefix}model.encoder.layer.{i}.adaLN_modulation.1")
    return key_map | KeyMap(sources)


def triplane_transformer(layers: int, prefix: str = "") -> KeyMap:
    """`TriplaneTransformer` from InstantMesh's; its deconvolution belongs to `Upsampler`, see `deconvolution`."""
    sources = {"position": _same(f"{prefix}pos_embed")} | _layer("norm", f"{prefix}norm")
    for i in range(layers):
        ours, theirs = f"layers.{i}", f"{prefix}layers.{i}"
        for norm in ("norm1", "norm2", "norm3"):
            sources |= _layer(f"{ours}.{norm}", f"{theirs}.{norm}")
        for index, name in enumerate("qkv"):
            sources[f"{ours}.cross_attn.{name}.weight"] = _same(f"{theirs}.cross_attn.{name}_proj_weight")
            sources[f"{ours}.self_attn.{name}.weight"] = Source(
                (f"{theirs}.self_attn.in_proj_weight",), lambda tensor, index=index: tensor.chunk(3)[index]
            )
        for attention in ("cross_attn", "self_attn"):
            sources[f"{ours}.{attention}.out.weight"] = _same(f"{theirs}.{attention}.out_proj.weight")
        sources |= _layer(f"{ours}.mlp.0", f"{theirs}.mlp.0")
        sources |= _layer(f"{ours}.mlp.2", f"{theirs}.mlp.3")  # A dropout lies between.
    return KeyMap(sources)


def density_decoder(hidden_layers: int, prefix: str = "") -> KeyMap:
    """GeoRM's decoder from that of InstantMesh's volume model: the first row of its output is the raw density.

    Ours is 0 on the surface, theirs `RAW_ISO`. The colours in the other rows have no place.
    """
    last = 2 * hidden_layers  # A ReLU lies between any two.
    sources = _hidden_layers(hidden_layers, f"{prefix}net")
    sources[f"{last}.weight"] = Source((f"{prefix}net.{last}.weight",), lambda weight: weight[:1])
    sources[f"{last}.bias"] = Source((f"{prefix}net.{last}.bias",), lambda bias: bias[:1] - RAW_ISO)
    return KeyMap(sources)


def distance_decoder(hidden_layers: int, prefix: str = "") -> KeyMap:
    """GeoRM's decoder from that of InstantMesh's mesh model: its signed distance is negative inside, ours positive.

    What colours and moves the vertices of its mesh has no place, so that this surface is near theirs, not the same.
    """
    last = 2 * hidden_layers
    sources = _hidden_layers(hidden_layers, f"{prefix}net_sdf")
    for part in ("weight", "bias"):
        sources[f"{last}.{part}"] = Source((f"{prefix}net_sdf.{last}.{part}",), torch.neg)
    return KeyMap(sources, tuple(f"{prefix}net_{name}." for name in ("rgb", "deformation", "weight")))


def instantmesh(config: ReconstructionConfig, mesh: bool) -> KeyMap:
    """GeoRM from InstantMesh's large reconstruction model; the super-resolution stays to be learned.

    Args:
        mesh: of the checkpoint of its second stage, which decodes a signed distance instead of a density.
    """
    decoder = distance_decoder if mesh else density_decoder
    parts = {
        "encoder": camera_encoder(config.encoder.depth, "encoder."),
        "transformer": triplane_transformer(config.transformer.layers, "transformer."),
        "upsampler": KeyMap(_layer("deconv", "transformer.deconv")),
        "decoder": decoder(config.decoder.hidden_layers, "synthesizer.decoder."),
    }
    result = KeyMap({})
    for name, part in parts.items():
        result |= part.renamed(f"model.{name}.", {})
    return result


def _same(key: str) -> Source:
    return Source((key,), lambda tensor: tensor)


def _pair(layer: str) -> tuple[str, str]:
    return f"{layer}.weight", f"{layer}.bias"


def _layer(ours: str, theirs: str) -> dict[str, Source]:
    """A layer's weight and bias."""
    return {mine: _same(key) for mine, key in zip(_pair(ours), _pair(theirs), strict=True)}


def _hidden_layers(count: int, theirs: str) -> dict[str, Source]:
    sources: dict[str, Source] = {}
    for i in range(count):
        sources |= _layer(f"{2 * i}", f"{theirs}.{2 * i}")
    return sources
