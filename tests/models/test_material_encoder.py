"""The cascade gives the reference's numbers; features cover the image and follow it."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from arm_blender.errors import CheckpointError
from arm_blender.models.material_encoder import MaterialEncoder, MaterialEncoderConfig, state_from_materialistic
from arm_blender.models.vit import VitConfig

FIXTURE = load_file(Path(__file__).parents[1] / "data/parity/materialistic_decoder_chain.safetensors")
CONFIG = MaterialEncoderConfig(VitConfig(8, 16, 4, 2, 4, 4), (0, 1, 2, 3), image_size=32, channels=8, out_channels=4)


def published() -> dict[str, torch.Tensor]:
    return {k.removeprefix("weights/"): v for k, v in FIXTURE.items() if k.startswith("weights/")}


@pytest.fixture
def encoder():
    torch.manual_seed(0)
    return MaterialEncoder(CONFIG)


def test_cascade_equals_the_published_one(encoder):
    ours = state_from_materialistic({f"net.{key}": tensor for key, tensor in published().items()})
    missing, unexpected = encoder.load_state_dict(ours, strict=False)
    assert not unexpected
    assert all(key.startswith(("vit.", "head.")) for key in missing)
    with torch.no_grad():
        path = encoder.fuse([FIXTURE[f"input/layer_{k}"] for k in (1, 2, 3, 4)], 4, 4)
    expected = FIXTURE["output/path_1"]
    assert (path - expected).abs().max() <= 1e-5 * expected.abs().max()


def test_published_cross_attention_is_dropped_and_an_unknown_key_refused():
    extra = {"net.cross_attention_1.q.weight": torch.zeros(1), "net.dino_model.pos_embed": torch.zeros(1, 17, 16)}
    assert set(state_from_materialistic(extra)) == {"vit.pos_embed"}
    with pytest.raises(CheckpointError, match=r"net\.surprise"):
        state_from_materialistic({"net.surprise": torch.zeros(1)})


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
