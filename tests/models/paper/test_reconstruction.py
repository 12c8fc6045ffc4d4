"""GeoRM and GlossyRM: what must hold of any weights."""

import dataclasses
import math

import pytest
import torch
from scipy.ndimage import distance_transform_edt

from arm_blender.graphics.cameras import front_on_x, orbit_camera
from arm_blender.graphics.visual_hull import signed_silhouette_distance
from arm_blender.graphics.voxels import sample_volume
from arm_blender.models.image_encoder import ImageEncoderConfig
from arm_blender.models.network_views import network_views
from arm_blender.models.paper.georm import ISO_DENSITY, GeoRM
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import PAPER, SMALL, ReconstructionConfig
from arm_blender.models.small.feature_volume import (
    COLORS,
    FeatureVolumeConfig,
    compared_colors,
    object_colors,
    plane_columns,
)
from arm_blender.models.small.pixel_aligned import PixelAlignedConfig
from arm_blender.models.transformer import TransformerConfig
from arm_blender.models.triplane import DecoderConfig, UpsamplerConfig, sample_planes
from arm_blender.structures import ViewSet

TINY = ReconstructionConfig(
    encoder=ImageEncoderConfig(image_size=32, patch_size=8, position_grid=4, width=16, depth=1, heads=2),
    transformer=TransformerConfig(width=16, layers=1, heads=2, grid=4),
    upsampler=UpsamplerConfig(filters=8, blocks=1, growth=4, doublings=1, channels=4),
    decoder=DecoderConfig(hidden_layers=2, hidden=16),
    pixel_aligned=PixelAlignedConfig(channels=8, hidden=8),
    volume=FeatureVolumeConfig(grid=8, channels=4),
)


def ball_views(radius: float, size: int = 64, distance: float = 4.0, views: int = 6) -> ViewSet:
    """Six views of a ball around the origin: its silhouette is a disc, by the tangent cone's half angle."""
    cameras = tuple(orbit_camera(60 * i, (20, -10)[i % 2], distance, 40, size, size) for i in range(views))
    disc = float(cameras[0].K[0, 0]) * math.tan(math.asin(radius / distance))
    centers = torch.arange(size) + 0.5 - size / 2
    alpha = (centers[:, None] ** 2 + centers[None] ** 2 <= disc**2).float()
    images = torch.cat([torch.full((3, size, size), 0.4), alpha[None]]).expand(views, -1, -1, -1)
    return ViewSet(images, cameras, torch.ones(views), "ball")


@pytest.fixture(scope="module")
def georm() -> GeoRM:
    torch.manual_seed(0)
    return GeoRM(TINY).eval()


def points(count: int) -> torch.Tensor:
    return torch.rand(1, count, 3, generator=torch.Generator().manual_seed(3)) * 2 - 1


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


@torch.no_grad()
def test_the_hull_distance_of_a_ball_is_its_signed_distance_in_front_of_a_camera(georm):
    # At the depth of the origin the cone of a ball of radius r has radius r / cos(half angle).
    radius, distance = 0.6, 4.0
    encoded = georm.encode(network_views(ball_views(radius, size=256, distance=distance), TINY))
    found = encoded.views.outlines.hull_distance(torch.zeros(1, 1, 3))[0, 0]
    cone = radius / math.cos(math.asin(radius / distance))
    assert float(found) == pytest.approx(cone, abs=0.02)


@torch.no_grad()
def test_the_hull_depth_of_a_balls_middle_is_the_balls_surface(georm):
    # Every view sees the same disc; along a view's own axis the others' cones are met near the ball itself.
    outlines = georm.encode(network_views(ball_views(0.6, size=128), TINY)).views.outlines
    met, depth = outlines.hull_depth(32)[0].unbind(1)
    middle = depth[:, 15:17, 15:17]
    assert bool((met[:, 15:17, 15:17] == 1).all())
    # The hull holds the ball, and six views around it leave less than a quarter of its radius over.
    assert bool((middle < -0.6 + 0.03).all()) and bool((middle > -0.75).all())
    assert float(met[:, 0, 0].sum()) == 0.0


def test_silhouette_distance_equals_scipys():
    alpha = torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(0)).round()
    for ours, mask in zip(signed_silhouette_distance(alpha), alpha.numpy() > 0.5, strict=True):
        inside, outside = distance_transform_edt(mask), distance_transform_edt(~mask)
        truth = torch.from_numpy((inside - 0.5).clip(0) - (outside - 0.5).clip(0)).float()
        assert torch.allclose(ours, truth, atol=1e-4)


def test_planes_are_xy_xz_zy_with_the_first_coordinate_along_the_width():
    ramp = torch.linspace(-1, 1, 64) * (64 - 1) / 64  # Texel centres of [-1, 1].
    planes = ramp.expand(64, 64).view(1, 1, 1, 64, 64).expand(1, 3, 1, -1, -1)
    found = sample_planes(planes, torch.tensor([[[0.1, 0.2, 0.3]]]))[0, 0]
    assert torch.allclose(found, torch.tensor([0.1, 0.1, 0.3]), atol=1e-5)


def test_a_volume_and_its_planes_agree_on_where_things_are():
    volume = torch.zeros(1, 1, 8, 8, 8)
    volume[0, 0, 6, 2, 5] = 1.0  # z, y, x
    x, y, z = ((torch.tensor([5, 2, 6]) + 0.5) / 8 * 2 - 1).tolist()
    assert float(sample_volume(volume, torch.tensor([[[x, y, z]]]))) == pytest.approx(1.0, abs=1e-5)
    highest = plane_columns(volume)[:, :, 1:]  # The second half of the channels is the maximum.
    found = sample_planes(highest, torch.tensor([[[x, y, z]]]))
    assert torch.allclose(found, torch.ones(1, 1, 3), atol=1e-5)


@torch.no_grad()
@pytest.mark.parametrize("background", [0.0, 0.5, 1.0])
def test_the_colour_of_the_object_has_nothing_of_the_background(background):
    """Half of every square shows the object."""
    coverage = torch.zeros(1, 1, 8, 8)
    coverage[..., ::2] = 1.0
    image = torch.tensor([0.2, 0.5, 0.9]).view(1, 3, 1, 1) * coverage + background * (1.0 - coverage)
    found = object_colors(torch.cat([image, coverage], dim=1), background, 2)
    assert found.shape == (1, 4, 2, 2)
    torch.testing.assert_close(found[0, :, 0, 0], torch.tensor([-0.3, 0.0, 0.4, 0.5]))
    nothing = object_colors(torch.cat([torch.full((1, 3, 8, 8), background), 0 * coverage], dim=1), background, 2)
    assert not nothing.any()


def test_views_that_agree_on_a_colour_have_no_spread_and_those_that_cannot_see_have_no_say():
    found = torch.tensor([0.1, -0.2, 0.3, 1.0]).expand(1, 3, 1, 4).clone()
    front, framed = torch.zeros(1, 3, 1), torch.ones(1, 3, 1)
    agreed = compared_colors(found, front, framed)
    assert agreed.shape == (1, 1, COLORS)
    assert float(agreed[..., 3:6].max()) < 0.05
    torch.testing.assert_close(agreed[0, 0, :3], torch.tensor([0.2, -0.4, 0.6]), atol=1e-3, rtol=0)
    found[0, 2, 0, :3] = 0.5
    assert float(compared_colors(found, front, framed)[..., 3:6].min()) > 0.5
    front[0, 2, 0] = -5.0  # Far behind what the view shows.
    torch.testing.assert_close(compared_colors(found, front, framed)[0, 0, :6], agreed[0, 0, :6], atol=1e-2, rtol=0)


def test_a_volume_that_compares_colours_sees_a_change_of_colour():
    torch.manual_seed(0)
    config = dataclasses.replace(TINY, volume=FeatureVolumeConfig(grid=8, channels=4, colors=True))
    network = GeoRM(config).eval()
    views = network_views(ball_views(0.6), config)
    grey = network.model.look(views)[1]
    other = dataclasses.replace(grey, colors=grey.colors + 0.3 * (grey.colors[:, :, 3:] > 0))
    assert grey.colors.shape[2] == 4
    with torch.no_grad():
        assert float((network.model.volume(grey) - network.model.volume(other)).abs().max()) > 1e-4


def test_glossyrm_starts_from_georm_and_stays_in_range(georm):
    glossy = GlossyRM(TINY)
    glossy.load_geometry(georm.state_dict())
    assert torch.equal(glossy.model.encoder.patch_embed.weight, georm.model.encoder.patch_embed.weight)
    values = glossy(glossy.encode(network_views(ball_views(0.7), TINY)), points(20))
    assert values.shape == (1, 20, 2) and bool(((values > 0) & (values < 1)).all())


@torch.no_grad()
def test_a_front_on_x_is_the_same_network_in_a_turned_world():
    torch.manual_seed(0)
    plain = dataclasses.replace(TINY, pixel_aligned=None, volume=None)
    ahead, aside = GeoRM(plain).eval(), GeoRM(dataclasses.replace(plain, front="+x")).eval()
    for name, parameter in ahead.named_parameters():
        if "modulation" in name:
            torch.nn.init.normal_(parameter)
    aside.load_state_dict(ahead.state_dict())
    views, p = network_views(ball_views(0.7), plain), points(50)
    turned = dataclasses.replace(views, c2w=front_on_x(views.c2w, dim=-2))
    expected = ahead.occupancy_logit(ahead.encode(turned), front_on_x(p, dim=-1))
    assert torch.equal(aside.occupancy_logit(aside.encode(views), p), expected)
    assert not torch.allclose(ahead.occupancy_logit(ahead.encode(views), p), expected)


def test_pixel_aligned_features_and_a_front_on_x_are_refused():
    with pytest.raises(ValueError, match="front"):
        dataclasses.replace(TINY, front="+x")


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
    assert PAPER.encoder.width == 768 and PAPER.pixel_aligned is None
    assert (PAPER.transformer.width, PAPER.transformer.layers, PAPER.transformer.heads) == (1024, 16, 16)
    assert PAPER.transformer.grid * 2**PAPER.upsampler.doublings == 256
    # 16 layers and norms of 263.7M were counted in the reference, which has a deconvolution of 0.3M more.
    layers = sum(p.numel() for p in model.transformer.parameters())
    assert layers == pytest.approx(263.7e6, rel=0.01)


def test_both_presets_share_one_architecture():
    assert {f.name for f in dataclasses.fields(SMALL)} == {f.name for f in dataclasses.fields(PAPER)}
