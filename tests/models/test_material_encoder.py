"""The cascade gives the reference's numbers; features cover the image and follow it."""

import pytest
import torch

from arm_blender.errors import CheckpointError
from arm_blender.models.material_encoder import Context, Fusion, MaterialEncoder, MaterialEncoderConfig, ResidualUnit
from arm_blender.models.vit import VitConfig
from arm_blender.weight_files.key_maps import KeyMap, convert, materialistic_cascade

CONFIG = MaterialEncoderConfig(VitConfig(8, 16, 4, 2, 4, 4), (0, 1, 2, 3), image_size=32, channels=8, out_channels=4)


@pytest.fixture
def encoder():
    torch.manual_seed(0)
    return MaterialEncoder(CONFIG)


def test_cascade_equals_the_published_one(encoder, parity):
    fixture = parity("materialistic_decoder_chain")
    ours = convert(fixture.weights, materialistic_cascade(), encoder.state_dict(), "fixture")
    missing, unexpected = encoder.load_state_dict(ours, strict=False)
    assert not unexpected
    assert all(key.startswith(("vit.", "head.")) for key in missing)
    with torch.no_grad():
        path = encoder.fuse([fixture.inputs[f"layer_{k}"] for k in (1, 2, 3, 4)], 4, 4)
    fixture.check(path, "path_1")


def load_part(module: torch.nn.Module, ours: str, state: dict[str, torch.Tensor]) -> None:
    """Fill the part of the cascade that is called `ours` there, and nothing else, by the key map."""
    whole = materialistic_cascade()
    sources = {
        key.removeprefix(f"{ours}."): source for key, source in whole.sources.items() if key.startswith(f"{ours}.")
    }
    module.load_state_dict(convert(state, KeyMap(sources, whole.unused), module.state_dict(), ours))


@torch.no_grad()
@pytest.mark.parametrize("name, factor", [("up", 2), ("noup", 1)])
def test_fusion_equals_the_published_one(parity, name, factor):
    fixture = parity(f"materialistic_fusion_{name}")
    fusion = Fusion(8, factor, joins=True)
    load_part(fusion, "fusions.0", {f"fusion_1.{key}": tensor for key, tensor in fixture.weights.items()})
    fixture.check(fusion(fixture.inputs["skip"], fixture.inputs["path"]), "two_inputs")
    fixture.check(fusion(fixture.inputs["skip"]), "one_input")


@torch.no_grad()
def test_the_deepest_fusion_leaves_out_what_joins(parity):
    fixture = parity("materialistic_fusion_noup")
    fusion = Fusion(8, 1, joins=False)
    load_part(fusion, "fusions.3", {f"fusion_4.{key}": tensor for key, tensor in fixture.weights.items()})
    fixture.check(fusion(fixture.inputs["skip"]), "one_input")


@torch.no_grad()
@pytest.mark.parametrize("unit, name", [("join", "resConfUnit1"), ("refine", "resConfUnit2")])
def test_residual_unit_equals_the_published_one(parity, unit, name):
    fixture, residual = parity("materialistic_residual_conv_unit"), ResidualUnit(8)
    load_part(residual, f"fusions.1.{unit}", {f"fusion_2.{name}.{key}": t for key, t in fixture.weights.items()})
    fixture.check(residual(fixture.inputs["x"]), "y")


@torch.no_grad()
def test_the_class_token_is_mixed_in_as_published(parity):
    fixture, context = parity("materialistic_project_readout"), Context(16, 16, factor=1)
    state = {f"spatial_transform_1.0.{key}": tensor for key, tensor in fixture.weights.items()}
    unmixed = {
        "spatial_transform_1.2.weight": torch.eye(16)[:, :, None, None],
        "spatial_transform_1.2.bias": torch.zeros(16),
    }
    load_part(context, "contexts.0", state | unmixed)
    fixture.check(context(fixture.inputs["tokens"], 3, 3).flatten(2).transpose(1, 2), "y")


def test_published_cross_attention_is_dropped_and_an_unknown_key_refused(encoder, parity):
    weights, own = parity("materialistic_decoder_chain").weights, encoder.state_dict()
    extra = weights | {"cross_attention_1.q.weight": torch.zeros(1)}
    assert (
        convert(extra, materialistic_cascade(), own, "f").keys()
        == convert(weights, materialistic_cascade(), own, "f").keys()
    )
    with pytest.raises(CheckpointError, match="fixture: surprise is unknown"):
        convert(weights | {"surprise": torch.zeros(1)}, materialistic_cascade(), own, "fixture")


def test_features_cover_images_of_any_size(encoder):
    with torch.no_grad():
        assert encoder(torch.rand(2, 3, 50, 70)).shape == (2, 4, 32, 32)


def test_every_part_learns(encoder):
    encoder(torch.rand(1, 3, 32, 32)).square().sum().backward()
    assert [name for name, p in encoder.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_features_stay_where_the_image_is(encoder):
    """A changed corner changes features there most."""
    images = torch.full((2, 3, 32, 32), 0.5)
    images[1, :, :8, 24:] = 1.0
    with torch.no_grad():
        features = encoder(images)
    change = (features[1] - features[0]).square().sum(0)
    assert change[:8, 24:].mean() > 2.0 * change[16:, :16].mean()
