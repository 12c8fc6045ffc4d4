"""The cascade gives the reference's numbers; features cover the image and follow it."""

import pytest
import torch

from arm_blender.errors import CheckpointError
from arm_blender.models.key_maps import convert, materialistic_cascade
from arm_blender.models.material_encoder import MaterialEncoder, MaterialEncoderConfig
from arm_blender.models.vit import VitConfig

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
