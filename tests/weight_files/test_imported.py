"""Weights of other projects arrive whole under our names, or are refused with a line that names what is wrong."""

import functools
import hashlib
import os
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from arm_blender.__main__ import main
from arm_blender.errors import CheckpointError
from arm_blender.models.image_encoder import ImageEncoder, ImageEncoderConfig
from arm_blender.models.material_encoder import MaterialEncoder, MaterialEncoderConfig
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.reconstruction import EncodedPlanes, ReconstructionConfig
from arm_blender.models.transformer import TransformerConfig
from arm_blender.models.triplane import DecoderConfig, UpsamplerConfig
from arm_blender.models.vit import VisionTransformer, VitConfig
from arm_blender.weight_files import checkpoints, imported

PARITY = Path(__file__).parents[1] / "data/parity"

TINY = ReconstructionConfig(
    encoder=ImageEncoderConfig(image_size=32, patch_size=8, position_grid=4, width=24, depth=2, heads=2),
    transformer=TransformerConfig(width=32, layers=7, heads=4, grid=4),
    upsampler=UpsamplerConfig(filters=8, blocks=1, growth=4, doublings=1, channels=9, deconvolution=True),
    decoder=DecoderConfig(hidden_layers=3, hidden=64),
    front="+x",
)
"""The sizes of the fixtures; layers and channels are to be read off the checkpoint."""


def parts(name: str, prefix: str) -> dict[str, Tensor]:
    """The weights, inputs or outputs of a fixture."""
    tensors = load_file(PARITY / f"{name}.safetensors")
    return {key.removeprefix(prefix): tensor for key, tensor in tensors.items() if key.startswith(prefix)}


def cut(state: dict[str, Tensor], width: int) -> dict[str, Tensor]:
    """A transformer of 32 channels made narrower."""
    sizes = {32 * times: width * times for times in (1, 3, 4)}
    return {key: t[tuple(slice(sizes.get(size, size)) for size in t.shape)].clone() for key, t in state.items()}


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Where weights are installed."""
    place = tmp_path / "weights"
    place.mkdir()
    monkeypatch.setattr(checkpoints.shipped, "__defaults__", (place,))
    monkeypatch.setattr(checkpoints.verify, "__defaults__", (place,))
    convert = functools.partial(imported.georm_from_instantmesh, config=TINY)
    monkeypatch.setitem(imported.KINDS, "georm", ("instantmesh.georm", convert))
    return place


@pytest.fixture
def tiny() -> dict[str, Tensor]:
    """A checkpoint of InstantMesh's keys with the fixtures' weights; the encoder is cut to the transformer's width."""
    state = {f"encoder.{k}": t for k, t in cut(parts("instantmesh_image_encoder", "weights/"), 24).items()}
    state |= {f"transformer.{k}": t for k, t in parts("instantmesh_triplane_transformer", "weights/").items()}
    state |= {f"synthesizer.{k}": t for k, t in parts("instantmesh_triplane_points", "weights/").items()}
    return {f"lrm_generator.{key}": tensor for key, tensor in state.items()} | {"lpips.lin0.weight": torch.zeros(1)}


@pytest.fixture
def checkpoint(tmp_path, tiny) -> Path:
    path = tmp_path / "instant_nerf_tiny.ckpt"
    torch.save({"state_dict": tiny}, path)
    return path


def check(found: Tensor, expected: Tensor) -> None:
    assert found.shape == expected.shape
    assert float((found - expected).abs().max()) <= 1e-5 * float(expected.abs().max())


@torch.no_grad()
def test_an_imported_checkpoint_gives_the_published_planes_and_density(checkpoint, folder, capsys):
    assert main(["weights", "import", str(checkpoint), "--as", "georm"]) == 0
    assert "CC-BY-NC" in capsys.readouterr().out
    path = folder / "instantmesh.georm.safetensors"
    config, state = checkpoints.load(path, ReconstructionConfig)
    assert (config.transformer.layers, config.upsampler.channels) == (2, 5)
    georm = GeoRM(config)
    checkpoints.restore(georm, state, path)
    name = "instantmesh_triplane_transformer"
    coarse = georm.model.transformer(parts(name, "input/")["image_feats"])
    check(georm.model.upsampler(coarse.flatten(0, 1)).unflatten(0, (2, 3)), parts(name, "output/")["planes"])
    name = "instantmesh_triplane_points"
    planes, points = parts(name, "input/")["planes"], parts(name, "input/")["points"]
    world = torch.stack([points[..., 1], -points[..., 0], points[..., 2]], dim=-1)  # Their front is +X.
    density = georm.density(EncodedPlanes(planes), world)
    check(density, parts(name, "output/")["sigma_activated"].squeeze(-1))


def test_an_imported_file_says_where_it_comes_from_and_is_recorded(checkpoint, folder):
    shipped = folder / checkpoints.SUMS
    shipped.write_text("0123  small.georm.safetensors\n")
    path, _ = imported.import_weights(checkpoint, "georm")
    header = checkpoints.read_header(path)
    assert header["source"] == "instant_nerf_tiny.ckpt" and "CC-BY-NC" in header["licence"]
    assert header["source_sha256"] == hashlib.sha256(checkpoint.read_bytes()).hexdigest()
    assert checkpoints.verify("instantmesh.georm")
    assert checkpoints.recorded_sum(folder / "small.georm.safetensors") == "0123"
    assert shipped.read_text() == "0123  small.georm.safetensors\n"  # What a user brings is none of it.
    (beside,) = folder.glob("*.sha256")
    assert beside.read_text() == f"{checkpoints.sha256(path)}  {path.name}\n"


def test_safetensors_and_bare_tables_are_read_alike(checkpoint, tiny, folder, tmp_path):
    expected = imported.import_weights(checkpoint, "georm")[0].read_bytes()
    torch.save(tiny, tmp_path / "bare.pth", _use_new_zipfile_serialization=False)
    save_file(tiny, tmp_path / "other.safetensors")
    for name in ("bare.pth", "other.safetensors"):
        converted = imported.import_weights(tmp_path / name, "georm", tmp_path / "out" / name)[1]
        state = checkpoints.load(folder / "instantmesh.georm.safetensors", ReconstructionConfig)[1]
        assert all(torch.equal(converted.state[key], state[key]) for key in state)
    assert (folder / "instantmesh.georm.safetensors").read_bytes() == expected


MISSING, SURPRISE = "transformer.norm.bias", "lrm_generator.surprise"


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda s: s.pop(f"lrm_generator.{MISSING}"), f"{MISSING} is missing"),
        (lambda s: s.update({SURPRISE: torch.zeros(1)}), "surprise is unknown"),
        (lambda s: s.update({f"lrm_generator.{MISSING}": torch.zeros(31)}), r"norm.bias \(31,\) gives \(31,\) instead"),
        (
            lambda s: s.update({"lrm_generator.transformer.layers.1.self_attn.in_proj_weight": torch.zeros(95, 32)}),
            r"layers.1.self_attn.in_proj_weight \(95, 32\) gives",
        ),
        (
            lambda s: s.update(
                {"lrm_generator.encoder.model.encoder.layer.0.attention.attention.key.weight": torch.zeros(24)}
            ),
            r"attention.key.weight \(24,\).* do not fit together",
        ),
        (lambda s: s[f"lrm_generator.{MISSING}"].fill_(float("nan")), "norm.bias.*not finite"),
    ],
    ids=["missing", "unknown", "shape", "split", "joined", "nan"],
)
def test_a_checkpoint_that_does_not_fit_is_refused_by_name(tiny, folder, tmp_path, capsys, change, line):
    change(tiny)
    path = tmp_path / "wrong.ckpt"
    torch.save({"state_dict": tiny}, path)
    with pytest.raises(CheckpointError, match=f"wrong.ckpt: .*{line}"):
        imported.import_weights(path, "georm")
    assert main(["weights", "import", str(path), "--as", "georm"]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(folder.iterdir())


class Trap:
    """Makes a folder when it is unpickled."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self):
        return os.mkdir, (str(self.place),)


@pytest.mark.parametrize("zipped", [True, False])
def test_code_in_a_checkpoint_is_never_run(folder, tmp_path, zipped):
    path, sprung = tmp_path / "trap.ckpt", tmp_path / "sprung"
    torch.save({"state_dict": {"a": torch.zeros(1)}, "trap": Trap(sprung)}, path, _use_new_zipfile_serialization=zipped)
    with pytest.raises(CheckpointError, match=r"trap\.ckpt: .*never run"):
        imported.import_weights(path, "georm")
    assert not sprung.exists()


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("missing.ckpt", None, "no such file"),
        ("folder", ..., "is a folder"),
        ("empty.ckpt", b"", "damaged"),
        ("noise.ckpt", bytes(range(256)), "damaged"),
        ("short.ckpt", b"PK\x03\x04", "damaged"),
        ("short.safetensors", b"\x80\x02", "damaged"),
    ],
)
def test_what_is_no_checkpoint_is_refused(folder, tmp_path, name, content, line):
    path = tmp_path / name
    if content is ...:
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(CheckpointError, match=f"{name}: {line}"):
        imported.import_weights(path, "georm")


def test_a_truncated_checkpoint_is_refused(checkpoint, folder):
    whole = checkpoint.read_bytes()
    for keep in (len(whole) // 2, len(whole) - 30):
        checkpoint.write_bytes(whole[:keep])
        with pytest.raises(CheckpointError, match="damaged"):
            imported.import_weights(checkpoint, "georm")


def test_what_holds_no_weights_is_refused(checkpoint, folder, tmp_path):
    for content in ({}, {"epoch": 3}, [torch.zeros(1)], {"state_dict": {"a": 1}}):
        torch.save(content, tmp_path / "odd.pth")
        with pytest.raises(CheckpointError, match="no table of tensors"):
            imported.import_weights(tmp_path / "odd.pth", "georm")
    ours, _ = imported.import_weights(checkpoint, "georm")
    with pytest.raises(CheckpointError, match="nothing to import"):
        imported.import_weights(ours, "georm")


VIT = VitConfig(patch=8, dim=32, depth=2, heads=2, grid=4)


def dino() -> dict[str, Tensor]:
    """The fixture's tensors under DINO's own names; the last norm is not in it."""
    return parts("dino_vit_patch8", "weights/") | {"norm.weight": torch.rand(32), "norm.bias": torch.rand(32)}


def in_transformers(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """The same tensors under the names of the transformers library."""
    names = {
        "cls_token": "embeddings.cls_token",
        "pos_embed": "embeddings.position_embeddings",
        "patch_embed.proj": "embeddings.patch_embeddings.projection",
        "blocks": "encoder.layer",
        "norm1": "layernorm_before",
        "norm2": "layernorm_after",
        "attn.proj": "attention.output.dense",
        "mlp.fc1": "intermediate.dense",
        "mlp.fc2": "output.dense",
    }
    found = {}
    for key, tensor in state.items():
        key = f"layernorm.{key[5:]}" if key.startswith("norm.") else key
        for old, new in names.items():
            key = key.replace(old, new)
        if "attn.qkv" in key:
            for name, third in zip(("query", "key", "value"), tensor.chunk(3), strict=True):
                found[key.replace("attn.qkv", f"attention.attention.{name}")] = third
        else:
            found[key] = tensor
    return found


@torch.no_grad()
@pytest.mark.parametrize("rename", [lambda state: state, in_transformers], ids=["hub", "transformers"])
def test_an_imported_dino_gives_the_published_tokens(rename, folder, tmp_path, monkeypatch):
    config = MaterialEncoderConfig(VIT, (0, 0, 1, 1), image_size=32, channels=8, out_channels=4)
    convert = functools.partial(imported.material_encoder_from_dino, config=config)
    monkeypatch.setitem(imported.KINDS, "material-encoder", ("paper.material_encoder", convert))
    torch.save(rename(dino()), tmp_path / "vit.pth")
    path, _ = imported.import_weights(tmp_path / "vit.pth", "material-encoder")
    config, state = checkpoints.load(path, MaterialEncoderConfig)
    encoder = MaterialEncoder(config)
    checkpoints.restore(encoder, state, path)
    size = "smaller_24x24"
    for index, tokens in enumerate(encoder.vit(parts("dino_vit_patch8", "input/")[size], (0, 1))):
        check(tokens, parts("dino_vit_patch8", "output/")[f"block_{index}/{size}"])


@torch.no_grad()
@pytest.mark.parametrize("rename", [lambda state: state, in_transformers], ids=["hub", "transformers"])
def test_an_imported_image_encoder_is_the_plain_transformer_until_it_learns_cameras(rename):
    state = dino()
    config = ImageEncoderConfig(image_size=32, patch_size=8, position_grid=4, width=32, depth=2, heads=2)
    encoder = ImageEncoder(config)
    encoder.load_state_dict(imported.image_encoder_from_dino(rename(state), "vit.pth", config).state)
    vit = VisionTransformer(VIT)
    vit.load_state_dict({key: tensor for key, tensor in state.items() if not key.startswith("norm.")})
    images = torch.rand(2, 3, 32, 32)
    last = vit((images - encoder.mean) / encoder.std, (1,))[0]
    expected = torch.nn.functional.layer_norm(last, (32,), state["norm.weight"], state["norm.bias"])
    check(encoder(images, torch.randn(2, 16)), expected)


def test_materialistic_brings_its_cascade_too():
    config = MaterialEncoderConfig(
        VitConfig(8, 16, 2, 2, 4, 4), (0, 0, 1, 1), image_size=32, channels=8, out_channels=4
    )
    vit = {f"dino_model.{key}": tensor for key, tensor in cut(dino(), 16).items()}
    theirs = vit | parts("materialistic_decoder_chain", "weights/")
    state = {f"net.{key}": tensor for key, tensor in theirs.items()}
    converted = imported.material_encoder_from_dino(state, "file", config)
    assert "rights reserved" in converted.licence
    assert torch.equal(converted.state["vit.blocks.1.attn.qkv.bias"], theirs["dino_model.blocks.1.attn.qkv.bias"])
    assert torch.equal(converted.state["fusions.0.join.conv1.weight"], theirs["fusion_1.resConfUnit1.conv1.weight"])
    MaterialEncoder(config).load_state_dict(converted.state)


def test_importing_leaves_the_callers_random_numbers_alone():
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    config = ImageEncoderConfig(image_size=32, patch_size=8, position_grid=4, width=32, depth=2, heads=2)
    first = imported.image_encoder_from_dino(dino_state := dino(), "file", config).state
    torch.manual_seed(5)
    again = imported.image_encoder_from_dino(dino_state, "file", config).state
    assert torch.equal(torch.rand(3), expected)
    assert all(torch.equal(first[key], again[key]) for key in first)
