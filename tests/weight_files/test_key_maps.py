"""Every tensor of the published checkpoints, at their sizes, has a place, and every place of ours is filled."""

import pytest
import torch
from torch import Tensor

from arm_blender.models.image_encoder import ImageEncoder, ImageEncoderConfig
from arm_blender.models.material_encoder import MaterialEncoder, MaterialEncoderConfig
from arm_blender.models.paper.georm import GeoRM
from arm_blender.weight_files import key_maps
from arm_blender.weight_files.imported import georm_from_instantmesh


def pair(name: str, *shape: int) -> dict[str, tuple[int, ...]]:
    return {f"{name}.weight": shape, f"{name}.bias": shape[:1]}


def transformers_vit(width: int, depth: int, patch: int, tokens: int) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the transformers library's ViT."""
    shapes = {"embeddings.cls_token": (1, 1, width), "embeddings.position_embeddings": (1, tokens, width)}
    shapes |= pair("embeddings.patch_embeddings.projection", width, 3, patch, patch) | pair("layernorm", width)
    for i in range(depth):
        layer = f"encoder.layer.{i}"
        for name in ("attention.attention.query", "attention.attention.key", "attention.attention.value"):
            shapes |= pair(f"{layer}.{name}", width, width)
        shapes |= pair(f"{layer}.attention.output.dense", width, width)
        shapes |= pair(f"{layer}.intermediate.dense", 4 * width, width)
        shapes |= pair(f"{layer}.output.dense", width, 4 * width)
        shapes |= pair(f"{layer}.layernorm_before", width) | pair(f"{layer}.layernorm_after", width)
    return shapes


def hub_vit(width: int, depth: int, patch: int, tokens: int) -> dict[str, tuple[int, ...]]:
    """Names and shapes of DINO's own ViT."""
    shapes = {"cls_token": (1, 1, width), "pos_embed": (1, tokens, width)}
    shapes |= pair("patch_embed.proj", width, 3, patch, patch) | pair("norm", width)
    for i in range(depth):
        block = f"blocks.{i}"
        shapes |= pair(f"{block}.norm1", width) | pair(f"{block}.norm2", width)
        shapes |= pair(f"{block}.attn.qkv", 3 * width, width) | pair(f"{block}.attn.proj", width, width)
        shapes |= pair(f"{block}.mlp.fc1", 4 * width, width) | pair(f"{block}.mlp.fc2", width, 4 * width)
    return shapes


def instantmesh(layers: int, channels: int, mesh: bool) -> dict[str, tuple[int, ...]]:
    """Names and shapes of InstantMesh's published checkpoints."""
    shapes = {f"encoder.model.{key}": shape for key, shape in transformers_vit(768, 12, 16, 197).items()}
    for i in range(12):
        shapes |= pair(f"encoder.model.encoder.layer.{i}.adaLN_modulation.1", 3072, 768)
    shapes |= pair("encoder.camera_embedder.0", 768, 16) | pair("encoder.camera_embedder.2", 768, 768)
    shapes["transformer.pos_embed"] = (1, 3072, 1024)
    shapes |= pair("transformer.norm", 1024)
    shapes |= {"transformer.deconv.weight": (1024, channels, 2, 2), "transformer.deconv.bias": (channels,)}
    for i in range(layers):
        layer = f"transformer.layers.{i}"
        for norm in ("norm1", "norm2", "norm3"):
            shapes |= pair(f"{layer}.{norm}", 1024)
        shapes[f"{layer}.cross_attn.q_proj_weight"] = (1024, 1024)
        shapes[f"{layer}.cross_attn.k_proj_weight"] = shapes[f"{layer}.cross_attn.v_proj_weight"] = (1024, 768)
        shapes[f"{layer}.cross_attn.out_proj.weight"] = shapes[f"{layer}.self_attn.out_proj.weight"] = (1024, 1024)
        shapes[f"{layer}.self_attn.in_proj_weight"] = (3072, 1024)
        shapes |= pair(f"{layer}.mlp.0", 4096, 1024) | pair(f"{layer}.mlp.3", 1024, 4096)
    nets = {"net_sdf": 1, "net_rgb": 3, "net_deformation": 3, "net_weight": 21} if mesh else {"net": 4}
    for name, outputs in nets.items():
        inputs = 3 * channels * (8 if name == "net_weight" else 1)
        widths = [inputs, 64, 64, 64, outputs]
        for i in range(4):
            shapes |= pair(f"synthesizer.decoder.{name}.{2 * i}", widths[i + 1], widths[i])
    return {f"lrm_generator.{key}": shape for key, shape in shapes.items()}


def of_shapes(shapes: dict[str, tuple[int, ...]]) -> dict[str, Tensor]:
    """Tensors that take no memory."""
    return {key: torch.empty(shape, device="meta") for key, shape in shapes.items()}


@pytest.mark.parametrize(
    ("layers", "channels", "mesh", "gigabytes"),
    [(16, 80, False, None), (16, 80, True, 1.51), (12, 40, False, None), (12, 40, True, 1.25)],
    ids=["nerf_large", "mesh_large", "nerf_base", "mesh_base"],
)
def test_every_tensor_of_the_published_sizes_finds_its_place(layers, channels, mesh, gigabytes):
    state = of_shapes(instantmesh(layers, channels, mesh))
    if gigabytes:  # What is published of the files: the table above is the whole of them.
        assert 4e-9 * sum(tensor.numel() for tensor in state.values()) == pytest.approx(gigabytes, abs=0.006)
    converted = georm_from_instantmesh(state, "file")
    assert (converted.config.transformer.layers, converted.config.upsampler.channels) == (layers, channels)
    with torch.device("meta"):
        own = GeoRM(converted.config).state_dict()
    assert {key: tensor.shape for key, tensor in converted.state.items()} == {k: t.shape for k, t in own.items()}
    fresh = {key for key, tensor in converted.state.items() if not tensor.is_meta}
    assert all(key.startswith("model.upsampler.") for key in fresh)


@pytest.mark.parametrize("layout", [hub_vit, transformers_vit])
def test_every_tensor_of_the_published_dinos_finds_its_place(layout):
    find = key_maps.hub_vit if layout is hub_vit else key_maps.transformers_vit
    with torch.device("meta"):
        tokens, material = ImageEncoder(ImageEncoderConfig()), MaterialEncoder(MaterialEncoderConfig())
    small, fine = of_shapes(layout(768, 12, 16, 197)), of_shapes(layout(768, 12, 8, 785))
    found = key_maps.convert(small, key_maps.image_encoder(find(12)), tokens.state_dict(), "vitb16")
    assert all("modulation" in key or "camera" in key for key in tokens.state_dict().keys() - found.keys())
    found = key_maps.convert(fine, key_maps.material_vit(find(12)), material.state_dict(), "vitb8")
    assert found.keys() == {key for key in material.state_dict() if key.startswith("vit.")}
