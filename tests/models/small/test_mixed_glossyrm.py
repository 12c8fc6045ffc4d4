"""GlossyRM of `small`: its volume and its planes agree on where things are, and its answers stay in range."""

import pytest
import torch

from arm_blender.graphics.voxels import sample_volume
from arm_blender.models.image_encoder import ImageEncoderConfig
from arm_blender.models.network_views import network_views
from arm_blender.models.small.mixed_glossyrm import MixedGlossyRM, MixedGlossyRMConfig, plane_columns
from arm_blender.models.transformer import TransformerConfig
from arm_blender.models.triplane import DecoderConfig, UpsamplerConfig, sample_planes

from ..balls import ball_views, points

TINY = MixedGlossyRMConfig(
    encoder=ImageEncoderConfig(image_size=32, patch_size=8, position_grid=4, width=16, depth=1, heads=2),
    transformer=TransformerConfig(width=16, layers=1, heads=2, grid=4),
    upsampler=UpsamplerConfig(filters=8, blocks=1, growth=4, doublings=1, channels=4),
    decoder=DecoderConfig(hidden_layers=2, hidden=16),
    features=8,
    reader=8,
    grid=8,
    channels=4,
)


@pytest.fixture(scope="module")
def glossyrm() -> MixedGlossyRM:
    torch.manual_seed(0)
    return MixedGlossyRM(TINY).eval()


@torch.no_grad()
def test_the_order_of_the_views_does_not_matter(glossyrm):
    views, p = ball_views(0.7), points(50)
    shuffled = views.only([3, 0, 5, 1, 4, 2])
    plain, again = (glossyrm(glossyrm.encode(network_views(v, TINY)), p) for v in (views, shuffled))
    assert torch.allclose(plain, again, atol=1e-4)


@torch.no_grad()
@pytest.mark.parametrize("count", [1, 2, 6, 16])
def test_any_number_of_views_gives_values_in_range(glossyrm, count):
    values = glossyrm(glossyrm.encode(network_views(ball_views(0.7, views=count), TINY)), points(20))
    assert values.shape == (1, 20, 2) and bool(((values > 0) & (values < 1)).all())


def test_a_volume_and_its_planes_agree_on_where_things_are():
    volume = torch.zeros(1, 1, 8, 8, 8)
    volume[0, 0, 6, 2, 5] = 1.0  # z, y, x
    x, y, z = ((torch.tensor([5, 2, 6]) + 0.5) / 8 * 2 - 1).tolist()
    assert float(sample_volume(volume, torch.tensor([[[x, y, z]]]))) == pytest.approx(1.0, abs=1e-5)
    highest = plane_columns(volume)[:, :, 1:]  # The second half of the channels is the maximum.
    found = sample_planes(highest, torch.tensor([[[x, y, z]]]))
    assert torch.allclose(found, torch.ones(1, 1, 3), atol=1e-5)
