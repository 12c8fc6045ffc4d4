"""A ball under a known light: held against views of itself nothing is wrong, under another light everything is."""

from dataclasses import replace

import pytest
import torch
import trimesh
from torch import Tensor

from arm_blender.errors import Cancelled
from arm_blender.graphics.cameras import Camera, orbit_camera, project, view_directions
from arm_blender.graphics.color import linear_from_srgb
from arm_blender.graphics.light.environment import shade
from arm_blender.graphics.light.harmonic_light import environment_of, harmonics_of
from arm_blender.graphics.light.spherical_harmonics import COUNT, WHITE
from arm_blender.knobs.finishes import Finish
from arm_blender.light_check.drawing import Drawing
from arm_blender.light_check.rerendering import PSNR_CAP, SIDE, check_by_light, psnr
from arm_blender.report import Report
from arm_blender.structures import MaterialMaps, Regions, TriangleMesh, UvMesh, ViewSet
from arm_blender.uv.unwrap import UnwrapConfig, unwrap

AROUND = ((20.0, 20.0), (140.0, -20.0), (260.0, 35.0))
WIDTH, HEIGHT = 72, 64


def sun(x: float, y: float, z: float) -> Tensor:
    """(9, 3) of white light, most of it from one side."""
    light = torch.zeros(COUNT, 3)
    light[0], light[1:4] = 0.6 * WHITE, 1.6 * torch.tensor([y, z, x])[:, None]
    return light


@pytest.fixture(scope="module")
def ball() -> UvMesh:
    made = trimesh.creation.icosphere(subdivisions=3, radius=0.8)
    whole = TriangleMesh(torch.tensor(made.vertices).float(), torch.tensor(made.faces))
    return unwrap(whole, UnwrapConfig(128, time_limit=0.0))[0]


def maps_of(albedo: float, roughness: float, light: Tensor | None) -> MaterialMaps:
    texels = torch.full((3, 16, 16), albedo)
    return MaterialMaps(texels, texels, roughness, 0.0, light=light)


def cameras() -> tuple[Camera, ...]:
    return tuple(orbit_camera(*place, 4.0, 30.0, WIDTH, HEIGHT) for place in AROUND)


def views_of(ball: UvMesh, maps: MaterialMaps, light: Tensor) -> ViewSet:
    pictures = torch.stack([Drawing(ball, maps).under(light, camera) for camera in cameras()])
    pictures = torch.cat([linear_from_srgb(pictures[:, :3]), pictures[:, 3:]], dim=1)
    return ViewSet(pictures, cameras(), torch.ones(len(pictures)), "ball", pictures=("a.png", "b.png", "c.png"))


def checked(ball: UvMesh, maps: MaterialMaps, views: ViewSet, **told) -> tuple[Report, Tensor | None]:
    report = Report("small", "cpu", 0, **told)
    return report, check_by_light(ball, maps, views, report)


def test_under_its_own_light_nothing_differs_and_under_another_everything_does(ball):
    true, wrong = sun(1.0, 0.0, 0.0), sun(-1.0, 0.0, 0.0)
    views = views_of(ball, maps_of(0.8, 0.6, None), true)
    report, sheet = checked(ball, maps_of(0.8, 0.6, true), views)
    assert report.light["psnr"] == PSNR_CAP
    assert [one["view"] for one in report.light["views"]] == ["a.png", "b.png", "c.png"]
    assert sheet.shape == (3, 3 * HEIGHT, 3 * WIDTH) and sheet.dtype == torch.uint8
    assert int(sheet[:, :, 2 * WIDTH :].max()) == 0  # The difference.
    report, sheet = checked(ball, maps_of(0.8, 0.6, wrong), views)
    assert all(one["psnr"] < 17.0 for one in report.light["views"])
    assert int(sheet[:, :, 2 * WIDTH :].max()) > 100
    torch.testing.assert_close(torch.tensor(report.light["harmonics"]), wrong)


def test_the_error_of_a_uniformly_wrong_albedo_is_that_of_its_grey(ball):
    even = torch.zeros(COUNT, 3)
    even[0] = WHITE
    # Rough, so that the ball is nearly of one grey; at an albedo of 0 the layer above the colour is left.
    views = views_of(ball, maps_of(0.5, 1.0, None), even)
    report, _ = checked(ball, maps_of(0.5, 1.0, 2.0 * even), views)
    grey, alpha = views.images[0, 0], views.images[0, 3] > 0.5
    drawn = Drawing(ball, maps_of(0.5, 1.0, None)).under(2.0 * even, cameras()[0])[:3, alpha]
    seen = Drawing(ball, maps_of(0.5, 1.0, None)).under(even, cameras()[0])[:3, alpha]
    expected = -10.0 * torch.log10((drawn - seen).square().mean())
    assert report.light["views"][0]["psnr"] == pytest.approx(float(expected), abs=0.02)
    assert float(grey[alpha].std()) < 0.02  # Of one grey: a furnace.


def test_a_picture_of_the_exr_the_light_becomes_shows_the_same_ball(ball):
    """An independent renderer: every texel of the environment, seen by each pixel of a view."""
    light, maps = sun(0.6, 0.0, 0.8), maps_of(0.7, 0.7, None)
    camera = cameras()[0]
    drawn = Drawing(ball, maps).under(light, camera)
    normal = torch.nn.functional.normalize(ball.vertices, dim=1)
    view = view_directions(ball.vertices, camera)
    facing = (normal * view).sum(dim=1) > 0.5
    ones = torch.ones(int(facing.sum()), 1)
    lights, albedo = environment_of(light, 32).texels(), 0.7 * ones.expand(-1, 3)
    expected = shade(normal[facing], view[facing], albedo, 0.7 * ones, 0.0 * ones, lights, form="cycles")
    pixels, _ = project(ball.vertices[facing], camera)
    column, row = pixels.long().unbind(1)
    found = linear_from_srgb(drawn[:3, row, column]).T
    assert float((found - expected).abs().mean()) < 0.02
    assert float(found.std()) > 0.1  # It has a bright side and a dark one: turned light would not fit.
    torch.testing.assert_close(harmonics_of(environment_of(light)), light, atol=1e-2, rtol=0.0)


def test_known_gains_are_given_back_to_each_view(ball):
    light, maps = sun(0.0, 1.0, 0.0), maps_of(0.3, 0.5, None)
    views = views_of(ball, maps, light)
    gains = [[1.25, 1.25, 1.25], [1.0, 0.9, 1.0], [0.8, 0.8, 0.8]]
    taken = views.images.clone()
    taken[:, :3] /= torch.tensor(gains)[:, :, None, None]
    assert float(taken[:, :3].max()) < 1.0  # Nothing is clipped.
    views = replace(views, images=taken)
    lit = replace(maps, light=light)
    assert checked(ball, lit, views, gains=gains)[0].light["psnr"] == PSNR_CAP
    assert checked(ball, lit, views)[0].light["psnr"] < 35.0


def test_what_is_set_by_hand_is_what_is_seen(ball):
    light, maps = sun(0.0, 1.0, 0.0), maps_of(0.6, 0.5, None)
    views = views_of(ball, maps, light)
    regions = Regions(torch.ones(16, 16, dtype=torch.uint8), (1.0,), ((0.6, 0.6, 0.6),))
    as_predicted = replace(maps, light=light, regions=regions)
    gold = replace(regions, finishes={1: Finish(0.2, 1.0, (1.0, 0.77, 0.34))})
    assert checked(ball, as_predicted, views)[0].light["psnr"] == PSNR_CAP
    assert checked(ball, replace(as_predicted, regions=gold), views)[0].light["psnr"] < 25.0


def test_large_views_are_drawn_small_and_come_out_as_well(ball):
    light, maps = sun(0.0, -1.0, 0.0), maps_of(0.6, 0.6, None)
    camera = orbit_camera(0.0, 10.0, 4.0, 30.0, 3 * SIDE, 3 * SIDE)
    picture = Drawing(ball, maps).under(light, camera)
    picture = torch.cat([linear_from_srgb(picture[:3]), picture[3:]])[None]
    views = ViewSet(picture, (camera,), torch.ones(1), "ball")
    report, sheet = checked(ball, replace(maps, light=light), views)
    assert sheet.shape == (3, SIDE, 3 * SIDE)
    assert report.light["psnr"] > 35.0
    assert report.light["views"][0]["view"] == "view 0"


def test_without_a_light_or_a_view_of_the_asset_it_is_left_out(ball):
    views = views_of(ball, maps_of(0.6, 0.6, None), sun(1.0, 0.0, 0.0))
    for maps, seen, why in (
        (maps_of(0.6, 0.6, None), views, "no light"),
        (maps_of(0.6, 0.6, sun(1.0, 0.0, 0.0)), replace(views, images=0.0 * views.images), "no view shows"),
    ):
        report, sheet = checked(ball, maps, seen)
        assert sheet is None and report.light is None and report.as_dict()["light"] is None
        assert [note.what for note in report.left_out] == ["check by light"] and why in report.left_out[0].why


def test_a_view_that_shows_nothing_of_the_asset_has_no_number(ball):
    light, maps = sun(1.0, 0.0, 0.0), maps_of(0.6, 0.6, None)
    views = views_of(ball, maps, light)
    images = views.images.clone()
    images[1] = 0.0
    report, _ = checked(ball, replace(maps, light=light), replace(views, images=images))
    assert [one["psnr"] for one in report.light["views"]] == [PSNR_CAP, None, PSNR_CAP]
    assert report.light["psnr"] == PSNR_CAP


def test_it_stops_when_it_is_told_to(ball):
    def stop(fraction: float, message: str) -> None:
        raise Cancelled

    light = sun(1.0, 0.0, 0.0)
    views = views_of(ball, maps_of(0.6, 0.6, None), light)
    with pytest.raises(Cancelled):
        check_by_light(ball, maps_of(0.6, 0.6, light), views, Report("small", "cpu", 0), stop)


def test_psnr_of_a_tenth_is_twenty():
    picture = torch.ones(4, 4, 4)
    assert psnr(torch.cat([0.9 * picture[:3], picture[3:]]), picture) == pytest.approx(20.0, abs=1e-3)
    assert psnr(0.0 * picture, picture) is None
