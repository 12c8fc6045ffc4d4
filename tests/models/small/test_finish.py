"""The finish: its evidence in closed form, and answers that stay in range whatever the pictures show."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
import trimesh
from torch import Tensor
from torch.nn import functional

from arm_blender import networks
from arm_blender.config import Settings
from arm_blender.models.small.delighting import SeenPoints
from arm_blender.models.small.finish import COUNT, NEAREST, Finish, FinishConfig, seen_points, spread, summary
from arm_blender.models.small.finish_evidence import NAMES, evidence
from arm_blender.structures import TriangleMesh

from ..balls import ball_views

GOLD = torch.tensor([0.9, 0.5, 0.1])

Shown = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Normals (P, 3), unit (V, P, 3) towards the eyes and where a mirror looks, to linear colours (V, P, 3)."""


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def ball(shown: Shown, views: int = 6, count: int = 1000) -> SeenPoints:
    """A ball of radius 0.8, each point seen by the cameras that it faces."""
    normal = functional.normalize(torch.randn(count, 3, generator=generator()), dim=1)
    eyes = 5.0 * functional.normalize(torch.randn(views, 3, generator=generator(1)), dim=1)
    position = 0.8 * normal
    towards = functional.normalize(eyes[:, None] - position, dim=2)
    cosine = (towards * normal).sum(dim=2, keepdim=True)
    color = shown(normal, towards, 2.0 * cosine * normal - towards)
    points = SeenPoints(position[None], normal[None], color[None], (cosine[..., 0] > 0.1)[None], eyes[None])
    return points.only(points.visible[0].any(dim=0).nonzero()[:, 0])


def lamp(mirrored: Tensor, sharpness: float = 8.0) -> Tensor:
    """(V, P, 1) of a lamp aside, as a mirror shows it."""
    place = functional.normalize(torch.tensor([0.4, -0.7, 0.6]), dim=0)
    return (sharpness * (mirrored @ place - 1.0)).exp()[..., None]


def matt(normal: Tensor, towards: Tensor, mirrored: Tensor) -> Tensor:
    return (0.3 + 0.2 * normal[:, 2:]).expand_as(towards)


def varnished(normal: Tensor, towards: Tensor, mirrored: Tensor) -> Tensor:
    return 0.3 * GOLD + 0.6 * lamp(mirrored)


def gold(normal: Tensor, towards: Tensor, mirrored: Tensor) -> Tensor:
    return GOLD * (0.3 + 0.6 * lamp(mirrored))


def numbers(shown: Shown, views: int = 6) -> dict[str, Tensor]:
    return dict(zip(NAMES, evidence(ball(shown, views)).T, strict=True))


def test_a_matt_surface_shows_no_change():
    found = numbers(matt)
    for name in ("spread", "brightest", "darkest", "skew", "grazing", "hue of change", "reflected 8"):
        assert float(found[name].abs().max()) < 1e-3, name


def test_a_polished_surface_repeats_what_others_mirror():
    polished, dull = numbers(varnished), numbers(matt)
    assert float(polished["explained 32"].mean()) > 0.15 > 0.01 > abs(float(dull["explained 32"].mean()))
    assert float(polished["spread"].mean()) > 0.05

    def at_random(normal: Tensor, towards: Tensor, mirrored: Tensor) -> Tensor:
        return 0.3 * GOLD + 0.6 * torch.rand(*towards.shape[:2], 1, generator=generator(5)) ** 4

    assert float(numbers(at_random)["explained 32"].mean()) < 0.05, "change alone is no reflection"


def test_a_metal_dyes_its_highlights_and_a_varnish_does_not():
    hues = []
    for shown in (gold, varnished):
        found = numbers(shown)
        changes = found["spread"] > 0.3
        assert int(changes.sum()) > 50
        hues.append(float(found["foreign hue"][changes].mean()))
    assert hues[0] < 0.3 * hues[1]


def test_what_mirrors_at_grazing_angles_is_seen_to():
    def grazing(normal: Tensor, towards: Tensor, mirrored: Tensor) -> Tensor:
        cosine = (towards * normal).sum(dim=2, keepdim=True)
        return (0.2 * (1.0 - cosine.clamp(0.0, 1.0)) ** 2 + 0.2).expand_as(towards)

    several = ball(grazing).visible[0].sum(dim=0) > 1
    assert float(numbers(grazing)["grazing"][several].median()) > 0.1


def test_the_order_of_views_does_not_matter():
    points = ball(gold)
    turned = SeenPoints(
        points.position, points.normal, points.color.flip(1), points.visible.flip(1), points.eyes.flip(1)
    )
    several = [
        k for k, name in enumerate(NAMES) if name.partition(" ")[0] not in ("mirrored", "reflected", "explained")
    ]
    # Mirrored light is read from some of the sights, which are others then.
    torch.testing.assert_close(evidence(turned)[:, several], evidence(points)[:, several], atol=1e-3, rtol=1e-3)


def test_points_of_no_object_are_a_mistake():
    points = ball(matt)
    with pytest.raises(ValueError, match="one object"):
        evidence(points.only(torch.zeros(0, dtype=torch.int64)))


def striped(normal: Tensor, towards: Tensor, mirrored: Tensor) -> Tensor:
    stripes = (20.0 * normal[:, 2:]).sin() > 0.0
    return torch.where(stripes, torch.tensor([0.0, 1.0, 0.02]), torch.tensor([1.0, 0.0, 0.8])).expand_as(towards)


EXTREMES: dict[str, Shown] = {
    "mirror": lambda normal, towards, mirrored: 0.5 + 0.5 * (40.0 * mirrored).sin(),
    "black": lambda normal, towards, mirrored: torch.zeros_like(towards),
    "white": lambda normal, towards, mirrored: torch.ones_like(towards),
    "burnt out": lambda normal, towards, mirrored: 40.0 * varnished(normal, towards, mirrored),
    "one coloured light": lambda n, towards, m: (
        torch.tensor([0.0, 0.0, 1.0]) * (0.02 + n[:, :1].clamp(min=0.0)) + 0 * m
    ),
    "fluorescent stripes": striped,
    "nothing": lambda normal, towards, mirrored: torch.full_like(towards, math.nan),
}


@pytest.fixture(scope="module")
def shipped() -> Finish:
    return networks.load("finish", Settings())


@pytest.mark.parametrize("views", [1, 2, 3, 6, 32])
@pytest.mark.parametrize("name", EXTREMES)
def test_extreme_pictures_have_a_finish(shipped, name, views):
    found = shipped(ball(EXTREMES[name], views))
    assert bool(((found.roughness >= 0.0) & (found.roughness <= 1.0)).all())
    assert bool(((found.metallic == 0.0) | (found.metallic == 1.0)).all())
    assert bool(((found.metal >= 0.0) & (found.metal <= 1.0)).all()) and 0.0 <= float(found.trust) <= 1.0


@pytest.mark.parametrize("count", [1, 2, NEAREST])
def test_a_few_points_are_enough(shipped, count):
    found = shipped(ball(gold).only(torch.arange(count)))
    assert found.roughness.shape == (count,) and bool(found.roughness.isfinite().all())


def test_points_in_one_place_are_bounded(shipped):
    points = ball(gold).only(torch.zeros(50, dtype=torch.int64))
    assert bool(shipped(points).roughness.isfinite().all())


@pytest.mark.parametrize(
    "views, readout", [(1, None), (2, None), (3, "few"), (4, "few"), (5, "several"), (9, "several")]
)
def test_so_many_views_are_read_by_what_was_fitted_to_them(views, readout):
    network = Finish(FinishConfig()).requires_grad_(False)
    for name in ("several", "few"):
        getattr(network, name).answer.weight.zero_()
        getattr(network, name).answer.bias.copy_(torch.tensor([0.3 if name == "several" else 0.6, 0.0]))
    rough = network(ball(gold, views)).roughness
    assert float(rough.min()) == float(rough.max()) == pytest.approx(0.6 if readout == "few" else 0.3)


@torch.no_grad()
def test_what_is_unlike_all_that_was_learnt_gets_the_usual_finish():
    """Numbers at twice the deviation of training have 1.5 / 4 of a say."""
    network = Finish(FinishConfig())
    network.several.answer.bias.copy_(torch.tensor([0.4, 0.1]))
    network.several.answer.weight.zero_()
    network.several.answer.weight[0, 0] = 0.1
    found = torch.full((9, COUNT), 2.0)
    network.several.object.mean.copy_(summary(found) - 2.0)
    said = network.read(found, 6)
    assert float(said.trust) == pytest.approx(1.5 / 4.0)
    torch.testing.assert_close(said.roughness, torch.full((9,), 0.4 + 0.1 * 2.0 * 1.5 / 4.0))


def test_spread_values_are_those_that_are_near():
    places = torch.rand(60, 3, generator=generator())
    values = places[:, :1].clone()
    torch.testing.assert_close(spread(torch.full((60, 2), 0.3), places, torch.rand(9, 3)), torch.full((9, 2), 0.3))
    assert float((spread(values, places, places) - values).abs().max()) < 0.1
    assert spread(values, places, places[:0]).shape == (0, 1)


def ball_and_cells(radius: float) -> tuple[TriangleMesh, Tensor]:
    """A ball and (7, 16, 16) cells that lie on it, but for the last rows."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    mesh = TriangleMesh(torch.from_numpy(ball.vertices.copy()).float(), torch.from_numpy(ball.faces.copy()))
    normal = functional.normalize(torch.randn(3, 16, 16, generator=generator()), dim=0)
    surface = torch.cat([torch.ones(1, 16, 16), radius * normal, normal])
    surface[:, 12:] = 0.0
    return mesh, surface


def test_points_are_where_views_see_the_surface():
    mesh, surface = ball_and_cells(0.7)
    views, asked = ball_views(0.7), []
    points = seen_points(mesh, views, surface, FinishConfig(points=100), lambda: asked.append(1))
    assert points is not None and points.position.shape == (1, 100, 3) and len(asked) == 6
    torch.testing.assert_close(points.position, 0.7 * points.normal)
    facing = (points.towards() * points.normal[:, None]).sum(dim=-1)
    assert float(facing[points.visible].min()) > 0.1 and bool(points.visible.any(dim=1).all())
    torch.testing.assert_close(points.color[points.visible], torch.full((int(points.visible.sum()), 3), 0.4))


def test_where_nothing_is_seen_there_are_no_points():
    mesh, surface = ball_and_cells(0.7)
    views = ball_views(0.7)
    assert seen_points(mesh, replace(views, images=0.0 * views.images), surface, FinishConfig()) is None


def test_maps_are_of_what_charts_cover(shipped):
    mesh, surface = ball_and_cells(0.7)
    points = seen_points(mesh, ball_views(0.7), surface, shipped.config)
    covered = surface[0] > 0.0
    for some in (points, None):
        found = shipped.maps(surface, some)
        assert bool((found[0, covered] > 0.0).all()) and not bool(found[:, ~covered].any())
    assert float(found[0].max()) == pytest.approx(float(shipped.several.answer.bias[0]))
