"""GeoRM and GlossyRM: what must hold of any weights."""

import dataclasses

import pytest
import torch

from arm_blender.graphics.cameras import front_on_x
from arm_blender.models.image_encoder import ImageEncoderConfig
from arm_blender.models.network_views import network_views
from arm_blender.models.paper.georm import ISO_DENSITY, GeoRM
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import PAPER, ReconstructionConfig
from arm_blender.models.transformer import TransformerConfig
from arm_blender.models.triplane import DecoderConfig, UpsamplerConfig

from ..balls import ball_views, points

TINY = ReconstructionConfig(
    encoder=ImageEncoderConfig(image_size=32, patch_size=8, position_grid=4, width=16, depth=1, heads=2),
    transformer=TransformerConfig(width=16, layers=1, heads=2, grid=4),
    upsampler=UpsamplerConfig(filters=8, blocks=1, growth=4, doublings=1, channels=4),
    decoder=DecoderConfig(hidden_layers=2, hidden=16),
)


@pytest.fixture(scope="module")
def georm() -> GeoRM:
    torch.manual_seed(0)
    return GeoRM(TINY).eval()


@torch.no_grad()
def test_the_order_of_the_views_does_not_matter(georm):
    views, p = ball_views(0.7), points(50)
    shuffled = views.only([3, 0, 5, 1, 4, 2])
    plain = georm.occupancy_logit(georm.encode(network_views(views, TINY)), p)
    again = georm.occupancy_logit(georm.encode(network_views(shuffled, TINY)), p)
    assert torch.allclose(plain, again, atol=1e-4)


@torch.no_grad()
@pytest.mark.parametrize("count", [1, 2, 6, 16])
def test_any_number_of_views_gives_a_finite_density(georm, count):
    encoded = georm.encode(network_views(ball_views(0.7, views=count), TINY))
    density = georm.density(encoded, points(50))
    assert density.shape == (1, 50) and bool(density.isfinite().all()) and bool((density >= 0).all())


@torch.no_grad()
def test_density_and_occupancy_agree_on_the_surface(georm):
    encoded = georm.encode(network_views(ball_views(0.7), TINY))
    inside = georm.occupancy_logit(encoded, points(500)) > 0
    assert torch.equal(georm.density(encoded, points(500)) > ISO_DENSITY, inside)


@torch.no_grad()
def test_a_point_outside_every_frame_is_no_nan(georm):
    encoded = georm.encode(network_views(ball_views(0.5, distance=1.05), TINY))
    near_a_pinhole = torch.tensor([[[0.0, -1.0, 0.36], [1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]]])
    assert bool(georm.occupancy_logit(encoded, near_a_pinhole).isfinite().all())


def test_glossyrm_starts_from_georm_and_stays_in_range(georm):
    glossy = GlossyRM(TINY)
    glossy.load_geometry(georm.state_dict())
    assert torch.equal(glossy.model.encoder.patch_embed.weight, georm.model.encoder.patch_embed.weight)
    values = glossy(glossy.encode(network_views(ball_views(0.7), TINY)), points(20))
    assert values.shape == (1, 20, 2) and bool(((values > 0) & (values < 1)).all())


@torch.no_grad()
def test_a_front_on_x_is_the_same_network_in_a_turned_world():
    torch.manual_seed(0)
    ahead, aside = GeoRM(TINY).eval(), GeoRM(dataclasses.replace(TINY, front="+x")).eval()
    for name, parameter in ahead.named_parameters():
        if "modulation" in name:
            torch.nn.init.normal_(parameter)
    aside.load_state_dict(ahead.state_dict())
    views, p = network_views(ball_views(0.7), TINY), points(50)
    turned = dataclasses.replace(views, c2w=front_on_x(views.c2w, dim=-2))
    expected = ahead.occupancy_logit(ahead.encode(turned), front_on_x(p, dim=-1))
    assert torch.equal(aside.occupancy_logit(aside.encode(views), p), expected)
    assert not torch.allclose(ahead.occupancy_logit(ahead.encode(views), p), expected)


@torch.no_grad()
def test_a_camera_changes_the_tokens_only_once_it_was_learnt():
    torch.manual_seed(0)
    plain = GeoRM(TINY).model.encoder.eval()
    images, cameras = torch.rand(2, 3, 32, 32), torch.randn(2, 16)
    assert torch.equal(plain(images, cameras), plain(images, cameras * 3))
    torch.nn.init.normal_(plain.blocks[0].modulation[1].weight)
    assert not torch.allclose(plain(images, cameras), plain(images, cameras * 3))


def test_the_paper_preset_has_the_papers_table():
    with torch.device("meta"):
        model = GeoRM(PAPER).model
    assert PAPER.encoder.width == 768
    assert (PAPER.transformer.width, PAPER.transformer.layers, PAPER.transformer.heads) == (1024, 16, 16)
    assert PAPER.transformer.grid * 2**PAPER.upsampler.doublings == 256
    # 16 layers and norms of 263.7M were counted in the reference, which has a deconvolution of 0.3M more.
    layers = sum(p.numel() for p in model.transformer.parameters())
    assert layers == pytest.approx(263.7e6, rel=0.01)
