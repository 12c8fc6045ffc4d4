"""GeoRM and GlossyRM on pictures and cameras that no scene should bring: numbers everywhere, or a surface nowhere."""

from dataclasses import replace

import pytest
import torch

from arm_blender.errors import EmptyMeshError
from arm_blender.graphics import silhouette_fill
from arm_blender.graphics.cameras import orbit_camera
from arm_blender.graphics.surface.isosurface import IsosurfaceConfig, extract
from arm_blender.models.network_views import network_views
from arm_blender.models.paper.georm import GeoRM
from arm_blender.models.paper.glossyrm import GlossyRM
from arm_blender.models.paper.reconstruction import EncodedPlanes
from arm_blender.models.small.volume_georm import EncodedVolumes, VolumeGeoRM
from arm_blender.structures import ViewSet

from .balls import ball_views, points
from .paper.test_reconstruction import TINY as PLANES
from .small.test_volume_georm import TINY as VOLUMES


def painted(color: float, alpha: float | None = None) -> ViewSet:
    """Six views of a ball of one grey; the whole picture where `alpha` is given."""
    views = ball_views(0.7)
    images = views.images.clone()
    images[:, :3] = color
    if alpha is not None:
        images[:, 3] = alpha
    return replace(views, images=images)


def with_camera_at(distance: float) -> ViewSet:
    """Six views, and a seventh from near or within the ball of radius 0.7, which fills its picture."""
    views = ball_views(0.7)
    near = orbit_camera(0.0, 0.0, distance, 60.0, 64, 64)
    images = torch.cat([views.images, torch.full((1, 4, 64, 64), 1.0)])
    return ViewSet(images, (*views.cameras, near), torch.ones(7), "near")


def one_pixel() -> ViewSet:
    views = painted(0.5, alpha=0.0)
    views.images[:, 3, 32, 32] = 1.0
    return views


EXTREMES = {
    "black": lambda: painted(0.0),
    "white": lambda: painted(1.0),
    "transparent": lambda: painted(0.5, alpha=0.0),
    "opaque": lambda: painted(0.5, alpha=1.0),
    "one pixel": one_pixel,
    "one view": lambda: ball_views(0.7, views=1),
    "thirty-two views": lambda: ball_views(0.7, views=32),
    "one view six times": lambda: ball_views(0.7).only([0] * 6),
    "a camera 0.01 from the surface": lambda: with_camera_at(0.71),
    "a camera on the surface": lambda: with_camera_at(0.7),
    "a camera inside": lambda: with_camera_at(0.2),
    "a camera in the middle": lambda: with_camera_at(1e-6),
}


@pytest.fixture(scope="module", params=["small", "paper"])
def georm(request) -> GeoRM | VolumeGeoRM:
    torch.manual_seed(0)
    return (VolumeGeoRM(VOLUMES) if request.param == "small" else GeoRM(PLANES)).eval()


@pytest.fixture(scope="module")
def glossyrm() -> GlossyRM:
    torch.manual_seed(0)
    return GlossyRM(PLANES).eval()


@pytest.fixture(autouse=True)
def coarse_filling(monkeypatch):
    """Silhouettes are filled on a coarser grid, which is the same work and takes a hundredth of the time."""
    for name, value in (("GRID", 16), ("SIDE", 40), ("STEPS", 22)):
        monkeypatch.setattr(silhouette_fill, name, value)


@torch.no_grad()
@pytest.mark.parametrize("name", EXTREMES)
def test_every_point_of_extreme_views_has_a_density(georm, name):
    encoded = georm.encode(network_views(EXTREMES[name](), georm.config))
    assert encoded.is_finite
    assert bool(georm.occupancy_logit(encoded, points(300)).isfinite().all())
    assert bool(georm.filled_logit(encoded, 4096)(points(300)[0]).isfinite().all())


@torch.no_grad()
@pytest.mark.parametrize("name", EXTREMES)
def test_every_point_of_extreme_views_has_a_material(glossyrm, name):
    values = glossyrm(glossyrm.encode(network_views(EXTREMES[name](), glossyrm.config)), points(300))
    assert bool(((values >= 0.0) & (values <= 1.0)).all())


@pytest.mark.parametrize("name", ["black", "one pixel", "a camera inside", "one view six times"])
def test_gradients_of_extreme_views_are_finite(name):
    torch.manual_seed(0)
    network = VolumeGeoRM(VOLUMES)
    network.occupancy_logit(network.encode(network_views(EXTREMES[name](), VOLUMES)), points(50)).sum().backward()
    found = [parameter.grad for parameter in network.parameters() if parameter.grad is not None]
    assert found and all(bool(gradient.isfinite().all()) for gradient in found)


@torch.no_grad()
def test_every_view_twice_tells_the_papers_networks_nothing_new():
    """Attention over tokens that are all there twice has the same weights in sum."""
    torch.manual_seed(0)
    network = GeoRM(PLANES).eval()
    views = ball_views(0.7)
    once = network.encode(network_views(views, PLANES)).planes
    twice = network.encode(network_views(views.only([*range(6), *range(6)]), PLANES)).planes
    torch.testing.assert_close(twice, once, rtol=0.0, atol=1e-5 * float(once.abs().max()))


@torch.no_grad()
def test_every_view_twice_has_the_same_hull():
    network = VolumeGeoRM(VOLUMES).eval()
    views = ball_views(0.7)
    once, twice = (
        network.encode(network_views(views.only([*range(6)] * times), VOLUMES)).views.outlines for times in (1, 2)
    )
    assert torch.equal(once.hull_distance(points(300)), twice.hull_distance(points(300)))


HUGE = [1e30, -1e30, torch.inf, -torch.inf, torch.nan]


def spoilt(encoded: EncodedPlanes | EncodedVolumes, value: float, everywhere: bool) -> EncodedPlanes | EncodedVolumes:
    """With a value in the planes, or in the coarse volume."""
    name = "planes" if isinstance(encoded, EncodedPlanes) else "volume"
    features = getattr(encoded, name).clone()
    if everywhere:
        features[:] = value
    else:
        features[0, 0, 0, 3, 4] = value
    return replace(encoded, **{name: features})


@torch.no_grad()
@pytest.mark.parametrize("everywhere", [True, False])
@pytest.mark.parametrize("value", HUGE)
def test_features_without_bounds_give_a_closed_surface_or_say_that_there_is_none(georm, value, everywhere):
    encoded = georm.encode(network_views(ball_views(0.7), georm.config))
    encoded = spoilt(encoded, value, everywhere)
    assert encoded.is_finite == (abs(value) == 1e30)
    try:
        mesh = extract(georm.filled_logit(encoded, 4096), IsosurfaceConfig(32, iso=0.0))
    except EmptyMeshError as error:
        assert "--dense" in str(error)
    else:
        assert bool(mesh.vertices.isfinite().all()) and float(mesh.vertices.abs().max()) <= 1.0
        edges = torch.stack([mesh.faces, mesh.faces.roll(-1, dims=1)], dim=-1).view(-1, 2)
        assert torch.equal(*(e.unique(dim=0) for e in (edges, edges.flip(1))))


@torch.no_grad()
@pytest.mark.parametrize("value", HUGE)
def test_what_is_no_number_does_not_spread_when_silhouettes_are_filled(value):
    torch.manual_seed(0)
    network = VolumeGeoRM(VOLUMES).eval()
    encoded = network.encode(network_views(ball_views(0.7), VOLUMES))
    encoded = spoilt(encoded, value, everywhere=False)
    p = points(2000)
    plain = network.occupancy_logit(encoded, p)[0].isfinite()
    assert 0.3 < float(plain.float().mean()) <= 1.0
    assert torch.equal(network.filled_logit(encoded, 4096)(p[0]).isfinite(), plain)
