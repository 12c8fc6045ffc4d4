"""GeoRM of `small`: what must hold of any weights, and what its outlines tell."""

import dataclasses
import math

import pytest
import torch

from arm_blender.models.network_views import network_views
from arm_blender.models.small.volume_georm import VolumeGeoRM, VolumeGeoRMConfig
from arm_blender.models.triplane import DecoderConfig

from ..balls import ball_views, points

TINY = VolumeGeoRMConfig(
    image_size=32, grid=8, channels=4, detail=4, reader=8, decoder=DecoderConfig(hidden_layers=2, hidden=16)
)


@pytest.fixture(scope="module")
def georm() -> VolumeGeoRM:
    torch.manual_seed(0)
    return VolumeGeoRM(TINY).eval()


@torch.no_grad()
def test_the_order_of_the_views_does_not_matter(georm):
    views, p = ball_views(0.7), points(50)
    shuffled = views.only([3, 0, 5, 1, 4, 2])
    plain = georm.occupancy_logit(georm.encode(network_views(views, TINY)), p)
    again = georm.occupancy_logit(georm.encode(network_views(shuffled, TINY)), p)
    assert torch.allclose(plain, again, atol=1e-4)


@torch.no_grad()
@pytest.mark.parametrize("count", [1, 2, 6, 16])
def test_any_number_of_views_gives_a_finite_occupancy(georm, count):
    encoded = georm.encode(network_views(ball_views(0.7, views=count), TINY))
    logit = georm.occupancy_logit(encoded, points(50))
    assert logit.shape == (1, 50) and bool(logit.isfinite().all())


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


@torch.no_grad()
def test_an_encoding_in_bfloat16_is_close_and_decoded_in_single_precision(georm):
    views, p = network_views(ball_views(0.7), TINY), points(200)
    plain = georm.encode(views)
    with torch.autocast("cpu", torch.bfloat16):
        half = georm.encode(views)
    assert half.volume.dtype == torch.bfloat16
    found, exact = (georm.occupancy_logit(encoded.float(), p) for encoded in (half, plain))
    assert found.dtype == torch.float32 and 0.0 < float((found - exact).abs().max()) < 0.05 * float(exact.std())


def test_a_change_of_colour_is_seen():
    torch.manual_seed(0)
    network = VolumeGeoRM(TINY).eval()
    grey = network.encode(network_views(ball_views(0.6), TINY)).views
    other = dataclasses.replace(grey, colors=grey.colors + 0.3 * (grey.colors[:, :, 3:] > 0))
    assert grey.colors.shape[2] == 4
    with torch.no_grad():
        assert float((network.volume(grey) - network.volume(other)).abs().max()) > 1e-4


@torch.no_grad()
def test_learning_starts_at_the_visual_hull():
    """With the last layers at zero the surface is where the hull is."""
    network = VolumeGeoRM(TINY).eval()
    for layer in (network.decoder[-1], network.coarse_vote, network.detail_vote):
        layer.weight.zero_()
        layer.bias.zero_()
    encoded, p = network.encode(network_views(ball_views(0.7), TINY)), points(500)
    hull = encoded.views.outlines.hull_distance(p)
    assert torch.equal(network.occupancy_logit(encoded, p) > 0.0, hull > 0.0)
    assert torch.equal(network.coarse_logit(encoded, p) > 0.0, hull > 0.0)
